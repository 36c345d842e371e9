"""The one exception that stands for a user's mistake."""


class InputError(ValueError):
    """Bad input: the message is one line that says what is wrong and how to mend it.

    Command lines turn it into that line on standard error and exit code 2
    (:func:`common.cli.run_command`); nobody should see a traceback for it.
    """


def one_line(error: Exception) -> str:
    """An error's message without line breaks, cut short; its class's name if it has none."""
    return " ".join(str(error).split())[:200] or type(error).__name__
