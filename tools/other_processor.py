"""Run a command as on another processor: ``python tools/other_processor.py COMMAND``.

Compiled functions, NumPy, SciPy, MKL, PyTorch and the C library use only instructions that all
processors of the kind have: sums are added in another order, products are rounded before they are
added. Functions compiled in this way are cached in ``outputs/other_processor``.
"""

import os
import sys
from pathlib import Path

import numpy as np

CACHE = Path(__file__).resolve().parents[1] / "outputs" / "other_processor"


def settings() -> dict[str, str]:
    """Environment variables, which libraries read when they are loaded."""
    # NumPy refuses the names of features that it was built without or the processor lacks.
    found = np.show_config(mode="dicts")["SIMD Extensions"].get("found", [])
    return {
        "NPY_DISABLE_CPU_FEATURES": " ".join(found),
        "NUMBA_CPU_NAME": "generic",
        "NUMBA_CACHE_DIR": str(CACHE),
        "OPENBLAS_CORETYPE": "Nehalem",
        "MKL_CBWR": "COMPATIBLE",
        "ATEN_CPU_CAPABILITY": "default",
        "ONEDNN_MAX_CPU_ISA": "SSE41",
        "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-FMA,-FMA4",
    }


if __name__ == "__main__":
    os.execvpe(sys.argv[1], sys.argv[1:], os.environ | settings())
