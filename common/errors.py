"""The exception for invalid input."""

MAX_LENGTH, MAX_LIST_LENGTH = 700, 4000  # characters of a message; of a list of faults


class InputError(ValueError):
    """Invalid input: the message is one line that states the fault and its remedy.

    Commands print it to standard error without a traceback and exit with code 2
    (:func:`common.cli.run_command`). Names in the message may be long or contain line breaks or
    unprintable characters: these are escaped, and the message is shortened to ``max_length``.
    """

    def __init__(self, message: str, *, max_length: int = MAX_LENGTH) -> None:
        if len(message) > max_length:
            message = f"{message[: max_length // 2]} … {message[-max_length // 2 :]}"
        super().__init__("".join(c if c.isprintable() else c.encode("unicode_escape").decode()
                                 for c in message))


def one_line(error: Exception) -> str:
    """An error's message without line breaks, shortened; the class name if it is empty."""
    return " ".join(str(error).split())[:200] or type(error).__name__
