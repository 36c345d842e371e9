"""A place for compiled kernels where numba has none, as in a read-only installation.

Numba keeps them beside the sources or in the user's cache, and refuses to compile without either.
"""

import os
import stat
import tempfile
from contextlib import suppress
from pathlib import Path

from sim.files import reason_closed

PLACES = (Path(__file__).with_name("__pycache__"),
          Path(os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")))
"""Where numba keeps kernels by itself."""


def ensure_kernel_cache() -> None:
    """Let numba use the folder for temporary files where nothing can be written to ``PLACES``.

    To be called before numba is imported, which reads the place from the environment.
    """
    if "NUMBA_CACHE_DIR" in os.environ or not all(map(reason_closed, PLACES)):
        return
    with suppress(OSError):
        folder = Path(tempfile.gettempdir()) / f"sim_kernels_{os.getuid()}"
        folder.mkdir(mode=0o700, exist_ok=True)
        found = folder.lstat()
        # Kernels are code: another user's must not be run.
        if found.st_uid == os.getuid() and stat.filemode(found.st_mode) == "drwx------":
            os.environ["NUMBA_CACHE_DIR"] = str(folder)
