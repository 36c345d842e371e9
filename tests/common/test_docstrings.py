"""``tools/check_docstrings.py`` finds public functions without units or shapes."""

import subprocess
import sys
from pathlib import Path

import common

SCRIPT = Path(common.__file__).parents[1] / "tools" / "check_docstrings.py"
MODULE = '''"""A module."""
import numpy as np
def bare(density: float) -> float:
    """Something of a density."""
def measured(density: float, width_mm: float) -> float:
    """Something of a density, kg/m²."""
def shapeless(values: np.ndarray) -> float:
    """The mean of values."""
def referring(values: np.ndarray, density: float) -> float:
    """The mean; arguments as for :func:`measured`."""
def _private(density: float) -> None:
    pass
class Fields:
    """Fields, J/m², of positions (V, 3)."""
    def energy(self, positions: np.ndarray) -> np.ndarray:
        """The energy."""
'''


def test_missing_units_and_shapes_are_found(tmp_path):
    (tmp_path / "sim").mkdir()
    (tmp_path / "sim" / "module.py").write_text(MODULE, encoding="utf-8")
    for words in (("init", "-q"), ("add", "sim")):
        subprocess.run(["git", "-C", str(tmp_path), *words], check=True)
    done = subprocess.run([sys.executable, SCRIPT], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 1
    assert [line.split(":", 2)[2] for line in done.stdout.splitlines()] == [
        " bare: no unit of density", " shapeless: no shape of its arrays, such as (V, 3)"]
