"""The exception for invalid input."""

import re
import reprlib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from errno import ENOMEM
from pathlib import Path

MAX_LENGTH, MAX_LIST_LENGTH = 700, 4000  # characters of a message; of a list of faults


class InputError(ValueError):
    """Invalid input: a line that states the fault and its remedy; commands exit with code 2.

    It begins with ``source``, a path ('': it is of no file, or names it in its ``message``), and
    ``joint``, a colon or a space before a verb. Unprintable characters of names in it are escaped,
    and it is shortened to ``max_length``.
    """

    def __init__(self, message: str, *, source: str | Path = "", joint: str = ": ",
                 max_length: int = MAX_LENGTH) -> None:
        self.source, self.joint, self.message = str(source), joint, message
        line = f"{source}{joint}{message}" if self.source else message
        if len(line) > max_length:
            line = f"{line[: max_length // 2]} … {line[-max_length // 2 :]}"
        super().__init__("".join(c if c.isprintable() else c.encode("unicode_escape").decode()
                                 for c in line))

    def within(self, folder: Path, name: str = "") -> "InputError":
        """The error with its source as it is called in ``folder``, which is itself ``name``: a
        client of a service must not see its paths."""
        place = Path(self.source)
        inside = self.source and place.is_relative_to(folder)
        called = self.source if not inside else name if place == folder else (
            place.relative_to(folder))
        # Messages that name a path in their middle.
        message = self.message.replace(f"{folder}/", "").replace(f"{folder}: ", f"{name}: " * bool(
            name)).replace(str(folder), name)
        return InputError(message, source=called, joint=self.joint,
                          max_length=max(MAX_LENGTH, len(str(self))))


@contextmanager
def of(source: str | Path) -> Iterator[None]:
    """State the file or folder that an InputError of the block is of, unless it has a source."""
    try:
        yield
    except InputError as error:
        if error.source:
            raise
        raise InputError(error.message, source=source) from None


def one_line(error: BaseException | str) -> str:
    """An error's message without line breaks, shortened, and without the objects that Pillow names,
    other at each run; the class name if it is empty."""
    text = re.sub(r" <_io\.\w+ object at \w+>", "", " ".join(str(error).split()))
    return text[:200] or type(error).__name__


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
