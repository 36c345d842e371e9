"""The scripts of ``make lint`` report a planted fault, and only that."""

import subprocess
import sys
from pathlib import Path

import pytest

TOOLS = Path(__file__).parents[2] / "tools"
FAULTS = {
    "check_layers.py": [
        ("sim/rig.py", "def f():\n    import train", "sim.rig imports train: sim must not"),
        ("data/files.py", "from data import shards", "import circle: data.files -> data.shards")],
    "check_docstrings.py": [
        ("sim/a.py", 'def f(density: float):\n    """A density."""', "f: no unit of density"),
        ("sim/a.py", 'def f(x: np.ndarray):\n    """The mean."""', "f: no shape of its arrays")],
}


@pytest.mark.parametrize("script", FAULTS)
def test_a_planted_fault_is_reported(tmp_path, script):
    sound = {"sim/mesh.py": 'def f(density: float):\n    """Of a density, kg/m²."""\n',
             "data/shards.py": "import data.files\n", "data/files.py": "import sim.mesh\n",
             "train.py": "import data.shards\n", f"tools/{script}": (TOOLS / script).read_text()}

    def report(**changed: str) -> list[str]:
        for name, text in (sound | changed).items():
            (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
            (tmp_path / name).write_text(text, encoding="utf-8")
        subprocess.run(["git", "add", "."], cwd=tmp_path, check=True)
        done = subprocess.run([sys.executable, f"tools/{script}"], cwd=tmp_path, text=True,
                              capture_output=True)
        lines = done.stdout.split("\n")
        assert not done.stderr and done.returncode == bool(lines[0])
        return [line for line in lines if line]

    subprocess.run(["git", "init", "-q"], cwd=tmp_path, check=True)
    assert report() == []
    for name, text, fault in FAULTS[script]:
        (line,) = report(**{name: text + "\n"})
        assert fault in line
        (tmp_path / name).unlink()
