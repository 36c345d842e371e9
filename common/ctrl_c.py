"""What Ctrl-C meets, and when; nothing changes by importing this (see :mod:`common.interrupt`)."""

import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

ONE_PRESS = 0.5
"""Seconds within which interruptions count as one: `timeout` and some shells send two."""
_last = -float("inf")


def interrupt(number: int, frame: FrameType | None) -> None:
    """A handler in place of Python's own: KeyboardInterrupt, but once a press."""
    global _last
    if time.monotonic() - _last > ONE_PRESS:
        _last = time.monotonic()
        raise KeyboardInterrupt


def end(number: int, frame: FrameType | None) -> None:
    """A handler for a command that has reported its interruption: another press ends it at once."""
    if time.monotonic() - _last > ONE_PRESS:
        signal.signal(number, signal.SIG_DFL)
        signal.raise_signal(number)


def require_interruption(error: KeyboardInterrupt | SystemError) -> None:
    """Raise ``error`` again unless it is Ctrl-C.

    A function that Numba compiled calls Python to make its results; an interruption there comes
    back as the cause of a SystemError, or of several, for as many results.
    """
    cause: BaseException | None = error
    while isinstance(cause, SystemError):
        cause = cause.__cause__
    if not isinstance(cause, KeyboardInterrupt):
        raise error


@contextmanager
def deferred() -> Iterator[None]:
    """Ctrl-C within takes effect at the end.

    Nothing changes in other threads than the main one, which never meet it, and where Ctrl-C means
    something else, as in jobs in the background, which ignore it.

    For imports of torch and Open3D: at some moments of their loading an interruption ends the
    process with an abort and C++'s own words, at others Python swallows it or takes it for a
    failure of the library. And for the end of worker processes, which would go on if it was cut
    short.
    """
    if (threading.current_thread() is not threading.main_thread()
            or signal.getsignal(signal.SIGINT) not in (interrupt, signal.default_int_handler)):
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
