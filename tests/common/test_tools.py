"""The project's tools: what they take for a fault, and how they change a processor."""

import subprocess
import sys
from pathlib import Path

import pytest

from sim.solver.linear import available_solvers
from tools.check_docstrings import complaints
from tools.wheel_trial import REPORT, TrialError, require_whole

ROOT = Path(__file__).parents[2]
TOOL = ROOT / "tools" / "other_processor.py"
ESTIMATE = {"resimulation": {"folds_simulated": 7}, "refined": {"simulations": 25}, "warnings": []}


def test_an_estimate_that_has_all_is_no_fault_of_the_wheel():
    require_whole(ESTIMATE, REPORT, refined=True)
    require_whole(ESTIMATE | {"refined": None}, (*REPORT, "more"), refined=False)


@pytest.mark.parametrize("part", ["refined", "resimulation", "report.pdf", "drape.glb"])
def test_a_part_left_out_with_a_warning_is_a_fault_of_the_wheel(part):
    lost = {"text": "the network's estimate is not refined: ModuleNotFoundError, drapenet.surface"}
    estimate = {key: value for key, value in ESTIMATE.items() if key != part}
    with pytest.raises(TrialError, match=rf"lacks {part}; its warnings: .*ModuleNotFoundError"):
        require_whole(estimate | {"warnings": [lost]}, [name for name in REPORT if name != part],
                      refined=True)


@pytest.mark.parametrize(("text", "fault"), [
    ('def f(density: float):\n    """Of a density, kg/m²."""\n', ""),
    ('def f(density: float):\n    """A density."""\n', "f: no unit of density"),
    ('def f(x: np.ndarray):\n    """The mean."""\n', "f: no shape of its arrays")])
def test_a_docstring_without_unit_or_shape_is_reported(tmp_path, text, fault):
    file = tmp_path / "a.py"
    file.write_text(text, encoding="utf-8")
    lines = complaints(file)
    assert len(lines) == bool(fault) and all(fault in line for line in lines)


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
