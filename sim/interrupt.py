"""Import this before everything else of a command: Ctrl-C during the other imports is one line.

They take seconds, before :func:`sim.cli.run_command` can see to it. The exit code is that of a
process ended by Ctrl-C, 130 in a shell.
"""

import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import TracebackType

_others = sys.excepthook


def _tell(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
    """In place of Python's own report of an error that nothing has caught."""
    if issubclass(kind, KeyboardInterrupt):
        print("interrupted", file=sys.stderr)
    else:
        _others(kind, error, trace)


sys.excepthook = _tell


@contextmanager
def deferred() -> Iterator[None]:
    """Ctrl-C within takes effect at the end.

    Nothing changes in other threads than the main one, which never meet it, and where Ctrl-C means
    something else, as in jobs in the background, which ignore it.

    For imports of torch: at some moments of its loading an interruption ends the process with an
    abort and C++'s own words, at others Python swallows it.
    """
    if (threading.current_thread() is not threading.main_thread()
            or signal.getsignal(signal.SIGINT) is not signal.default_int_handler):
        yield
        return
    came = []
    # Blocking the signal would leave it to the threads that NumPy has started.
    before = signal.signal(signal.SIGINT, lambda *_: came.append(True))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
    if came:
        raise KeyboardInterrupt
