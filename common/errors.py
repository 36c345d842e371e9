"""The exception for invalid input."""

import reprlib
from contextlib import suppress
from errno import ENOMEM

MAX_LENGTH, MAX_LIST_LENGTH = 700, 4000  # characters of a message; of a list of faults


class InputError(ValueError):
    """Invalid input: a line that states the fault and its remedy; commands exit with code 2.

    Unprintable characters of names in it are escaped, and it is shortened to ``max_length``.
    """

    def __init__(self, message: str, *, max_length: int = MAX_LENGTH) -> None:
        if len(message) > max_length:
            message = f"{message[: max_length // 2]} … {message[-max_length // 2 :]}"
        super().__init__("".join(c if c.isprintable() else c.encode("unicode_escape").decode()
                                 for c in message))


def one_line(error: BaseException | str) -> str:
    """An error's message without line breaks, shortened; the class name if it is empty."""
    return " ".join(str(error).split())[:200] or type(error).__name__


def lacks_memory(error: BaseException | None) -> bool:
    """Whether the system refused memory, to an array or a library that was to be loaded."""
    return error is not None and (
        isinstance(error, MemoryError) or "failed to map segment" in str(error)
        or getattr(error, "errno", None) == ENOMEM or lacks_memory(error.__context__))


def shortened(text: str, length: int) -> str:
    """A text of at most ``length`` characters, with an ellipsis in place of its end."""
    return text if len(text) <= length else f"{text[: length - 1]}…"


def shown(value: object) -> str:
    """``repr`` of a value, shortened: values from files may be long or contain line breaks."""
    with suppress(ValueError):  # integers of thousands of digits
        return reprlib.repr(value)[:60]
    return "a number of thousands of digits"
