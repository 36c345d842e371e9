"""Functions that Numba compiles once for an installation, into its cache.

The cache is beside the sources, or, where these cannot be written, in the user's folder
(``NUMBA_CACHE_DIR`` states another).
"""

import sys
from collections.abc import Callable
from functools import cache, wraps
from pathlib import Path
from typing import Any


def compiled(function: Callable) -> Callable:
    """A function that is compiled, or read from the cache, when it is first called, as importing
    Numba takes 0.2 s; compiled functions cannot call it."""
    @cache
    def machine() -> Callable:
        import numba

        return numba.njit(cache=True)(function)

    @wraps(function)
    def called(*arguments: Any) -> Any:
        return machine()(*arguments)

    return called


def announce(function: Any) -> None:
    """Say on the terminal that compilation takes time, unless a function of ``numba.njit`` that is
    among the last to be compiled is in the cache."""
    place = Path(function.stats.cache_path)
    if not any(place.glob(f"*{function.__name__}*.nbi")):
        print("compiling the simulator for this installation, once: a minute",
              file=sys.stderr, flush=True)
