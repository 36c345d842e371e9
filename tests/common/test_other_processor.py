import subprocess
import sys
from pathlib import Path

import pytest

from sim.solver.linear import available_solvers

ROOT = Path(__file__).parents[2]
TOOL = ROOT / "tools" / "other_processor.py"


def seen(code):
    """What Python prints as on another processor; warnings of libraries are errors."""
    result = subprocess.run(
        [sys.executable, TOOL, sys.executable, "-W", "error::RuntimeWarning", "-W",
         "error::ImportWarning", "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    return result.stdout.split()


def test_numpy_and_compiled_functions_use_no_special_instructions():
    code = ("import numpy as np; from numba.core import config; "
            "print(*np.show_config(mode='dicts')['SIMD Extensions'].get('found', []), "
            "config.CPU_NAME, repr(config.CPU_FEATURES), config.CACHE_DIR)")
    assert seen(code) == ["generic", "''", str(ROOT / "outputs" / "other_processor")]


@pytest.mark.skipif(len(available_solvers()) < 2, reason="no MKL on this processor")
def test_a_branch_of_mkl_chosen_outside_is_kept_also_in_workers(monkeypatch):
    monkeypatch.delenv("MKL_CBWR", raising=False)
    code = ("from common.workers import ONE_THREAD; from sim.solver.linear import find_mkl; "
            "print(find_mkl().MKL_CBWR_Get(-1), ONE_THREAD['MKL_CBWR'])")
    assert seen(code) == ["3", "COMPATIBLE"]
    plain = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True,
                           cwd=ROOT)
    assert plain.stdout.split() == ["2", "AUTO"]
