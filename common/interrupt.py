"""Ctrl-C ends a command at once, with one line and exit code 130.

A command imports this module before all others, whose imports take seconds; libraries never import
it. No exception passes through compiled functions and half-loaded libraries: files are complete
under their names or do not exist (:mod:`common.files`), and workers end with the main process.
"""

import os
import signal
import sys
import threading
from contextlib import suppress
from types import FrameType

from common.files import remove_unfinished


def end(number: int, frame: FrameType | None) -> None:
    """Signal handler that ends the process."""
    with suppress(Exception):  # a closed stream, or one that is being written to
        sys.stdout.flush()
    remove_unfinished()
    with suppress(OSError):
        os.write(2, b"\ninterrupted\n" if os.isatty(2) else b"interrupted\n")
    os._exit(130)


# The process that releases the semaphores of ended processes would report that it does.
os.environ.setdefault("PYTHONWARNINGS", "ignore:resource_tracker")
if (threading.current_thread() is threading.main_thread()
        and signal.getsignal(signal.SIGINT) is signal.default_int_handler):
    signal.signal(signal.SIGINT, end)
