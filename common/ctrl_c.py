"""Handlers of Ctrl-C. Importing this installs none (see :mod:`common.interrupt`)."""

import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

MIN_INTERVAL = 0.5
"""Seconds within which interruptions count as one: `timeout` and certain shells send two."""
_last = -float("inf")


def interrupt(number: int, frame: FrameType | None) -> None:
    """Signal handler that raises one KeyboardInterrupt per key press."""
    global _last
    if time.monotonic() - _last > MIN_INTERVAL:
        _last = time.monotonic()
        raise KeyboardInterrupt


def end(number: int, frame: FrameType | None) -> None:
    """Signal handler after a reported interruption: another key press ends the process at once."""
    if time.monotonic() - _last > MIN_INTERVAL:
        signal.signal(number, signal.SIG_DFL)
        signal.raise_signal(number)


def require_interruption(error: KeyboardInterrupt | SystemError) -> None:
    """Raise ``error`` again unless Ctrl-C caused it.

    A function compiled by Numba calls Python to create its results; an interruption there becomes
    the cause of a SystemError, or of a chain of them, one per result.
    """
    cause: BaseException | None = error
    while isinstance(cause, SystemError):
        cause = cause.__cause__
    if not isinstance(cause, KeyboardInterrupt):
        raise error


@contextmanager
def deferred() -> Iterator[None]:
    """Defer Ctrl-C to the end of the block.

    Without effect in threads other than the main one, which never receive it, and where another
    handler is installed, as in background jobs, which ignore it.

    Used for imports of torch and Open3D: depending on the moment, an interruption during loading
    aborts the process with a C++ message, is swallowed by Python or is taken for a failure of the
    library. Also used for the shutdown of worker processes, which would continue if it was
    interrupted.
    """
    if (threading.current_thread() is not threading.main_thread()
            or signal.getsignal(signal.SIGINT) not in (interrupt, signal.default_int_handler)):
        yield
        return
    received = []
    # A blocked signal would be delivered to the threads that NumPy has started.
    before = signal.signal(signal.SIGINT, lambda *_: received.append(True))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
    if received:
        raise KeyboardInterrupt
