"""``tools/check_layers.py`` finds what it is there to find."""

import subprocess
import sys
from pathlib import Path

import pytest

import common

SCRIPT = Path(common.__file__).parents[1] / "tools" / "check_layers.py"


def check(root: Path) -> list[str]:
    """The lines that the check, as a tool of a project in ``root``, prints."""
    script = root / "tools" / SCRIPT.name
    script.parent.mkdir(exist_ok=True)
    script.write_bytes(SCRIPT.read_bytes())
    done = subprocess.run([sys.executable, script], capture_output=True, text=True)
    assert not done.stderr and done.returncode == bool(done.stdout)
    return done.stdout.splitlines()


@pytest.fixture
def project(tmp_path):
    """A project in order: functions to add files to it, and to look at it."""
    def write(name: str, text: str) -> None:
        file = tmp_path / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text, encoding="utf-8")

    write("common/__init__.py", "")
    write("common/errors.py", "import os\n")
    write("sim/__init__.py", "from sim.mesh import Mesh\n")
    write("sim/mesh.py", "from common import errors\nfrom . import rig\n")
    write("sim/rig.py", "from common.errors import InputError\n" + 349 * "#\n")
    write("data/shards.py", "import sim.mesh\n")
    write("train.py", "from data.shards import write\n")
    assert check(tmp_path) == []
    return write, lambda: check(tmp_path)


@pytest.mark.parametrize("text", [
    "import data.shards", "from data import shards", "from data.shards import write",
    "def late():\n    from .shards import write",
    "if TYPE_CHECKING:\n    from .. import data\n    from ..data import shards",
])
def test_a_planted_circle_is_found(project, text):
    write, look = project
    write("data/shards.py", "import data.parts.reader\n")
    write("data/parts/reader.py", "from data import files\n")
    assert look() == []
    write("data/files.py", text + "\n")
    (line,) = look()
    circle = line.removeprefix("import circle: ").split(" -> ")
    assert circle[0] == circle[-1]
    steps = {"data.shards": "data.parts.reader", "data.parts.reader": "data.files",
             "data.files": "data.shards"}
    assert [steps[name] for name in circle[:-1]] == circle[1:] and len(circle) == 4


def test_every_circle_is_found(project):
    write, look = project
    for pair in ("ab", "cd"):
        for one, other in (pair, pair[::-1]):
            write(f"drapenet/{one}.py", f"from drapenet.{other} import x\n")
    assert len(look()) == 2


@pytest.mark.parametrize(("name", "text", "said"), [
    ("sim/scene.py", "from data.shards import read", "sim.scene imports data.shards"),
    ("sim/scene.py", "def f():\n    import train", "sim.scene imports train"),
    ("common/cli.py", "from sim import mesh", "common.cli imports sim.mesh"),
])
def test_what_breaks_the_layers_is_found(project, name, text, said):
    write, look = project
    write(name, text)
    (line,) = look()
    assert line.startswith(said)
