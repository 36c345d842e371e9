"""Ctrl-C ends a command at once, with one line and exit code 130; a lack of memory, or of packages
that only trainings need, with one and 2.

A command imports this module before all others, whose imports take seconds; libraries never import
it. No exception passes through compiled functions and half-loaded libraries: files are complete
under their names or do not exist (:mod:`common.files`), and workers end with the main process.
"""

import os
import signal
import sys
import threading
from contextlib import suppress
from types import FrameType, TracebackType

from common.errors import lacks_memory, one_line
from common.files import remove_unfinished

os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")  # whose search takes 20 ms
TRAINING = ("torch", "torchvision", "tensorboard", "onnx", "onnxscript", "h5py", "open3d",
            "sklearn")
"""Packages of ``drapenet[train]``."""


def end(number: int, frame: FrameType | None) -> None:
    """Signal handler that ends the process."""
    with suppress(Exception):  # a closed stream, or one that is being written to
        sys.stdout.flush()
    remove_unfinished()
    with suppress(OSError):
        os.write(2, b"\ninterrupted\n" if os.isatty(2) else b"interrupted\n")
    os._exit(130)


def report(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
    """Exception hook that prints one line and ends the process where memory is refused or a package
    is not installed."""
    if isinstance(error, ModuleNotFoundError) and error.name in TRAINING:
        line = (f"{error.name} is not installed; this command needs the packages of datasets and "
                "trainings: pip install 'drapenet[train]', or, in a checkout, make setup")
    elif lacks_memory(error):
        line = (f"too little memory ({one_line(error)}); a command needs up to 5 GB for each "
                "process: raise its limit (ulimit -v), or end other programs")
    else:
        sys.__excepthook__(kind, error, trace)
        return
    remove_unfinished()
    os.write(2, f"error: {line}\n".encode())
    os._exit(2)


# The process that releases the semaphores of ended processes would report that it does.
os.environ.setdefault("PYTHONWARNINGS", "ignore:resource_tracker")
if threading.current_thread() is threading.main_thread():
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, end)
    if sys.excepthook is sys.__excepthook__:
        sys.excepthook = report
