"""What is said of functions that Numba compiles once for an installation, into its cache.

The cache is beside the sources, or, where these cannot be written, in the user's folder
(``NUMBA_CACHE_DIR`` states another).
"""

import sys
from pathlib import Path
from typing import Any


def announce(function: Any) -> None:
    """Say on the terminal that compilation takes time, unless a function of ``numba.njit`` that is
    among the last to be compiled is in the cache."""
    place = Path(function.stats.cache_path)
    if not any(place.glob(f"*{function.__name__}*.nbi")):
        print("compiling the simulator for this installation, once: a minute",
              file=sys.stderr, flush=True)
