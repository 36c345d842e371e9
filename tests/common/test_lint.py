"""``tools/check_docstrings.py`` reports a planted fault, and only that."""

import pytest

from tools.check_docstrings import complaints


@pytest.mark.parametrize(("text", "fault"), [
    ('def f(density: float):\n    """Of a density, kg/m²."""\n', ""),
    ('def f(density: float):\n    """A density."""\n', "f: no unit of density"),
    ('def f(x: np.ndarray):\n    """The mean."""\n', "f: no shape of its arrays")])
def test_a_planted_fault_is_reported(tmp_path, text, fault):
    file = tmp_path / "a.py"
    file.write_text(text, encoding="utf-8")
    lines = complaints(file)
    assert len(lines) == bool(fault) and all(fault in line for line in lines)
