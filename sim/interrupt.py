"""Import this before everything else of a command: Ctrl-C during the other imports is one line.

They take seconds, before :func:`sim.cli.run_command` can see to it. The exit code is that of a
process ended by Ctrl-C, 130 in a shell.
"""

import signal
import sys
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
    """Ctrl-C within takes effect at the end, in the thread that calls this.

    For imports of torch: at some moments of its loading an interruption ends the process with an
    abort and C++'s own words, at others Python swallows it.
    """
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
