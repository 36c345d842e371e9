"""The one exception that stands for a user's mistake."""

LONGEST, LONGEST_LIST = 700, 4000  # characters of a message, of one that lists many faults


class InputError(ValueError):
    """Bad input: the message is one line that says what is wrong and how to mend it.

    Command lines turn it into that line on standard error and exit code 2
    (:func:`common.cli.run_command`); nobody should see a traceback for it. Names that it repeats
    may have lines, be long or be no text: the message is one short line of text all the same.
    """

    def __init__(self, message: str, *, longest: int = LONGEST) -> None:
        if len(message) > longest:
            message = f"{message[: longest // 2]} … {message[-longest // 2 :]}"
        super().__init__("".join(c if c.isprintable() else c.encode("unicode_escape").decode()
                                 for c in message))


def one_line(error: Exception) -> str:
    """An error's message without line breaks, cut short; its class's name if it has none."""
    return " ".join(str(error).split())[:200] or type(error).__name__
