"""``python -m sim``: files, figures, and one line for a mistake."""

import json
import subprocess
import sys

import pytest

from sim.cli import parse_overrides
from sim.errors import InputError


def run(*words: str) -> subprocess.CompletedProcess:
    return subprocess.run([sys.executable, "-m", "sim", *words], capture_output=True, text=True)


def test_writes_mesh_picture_and_figures(tmp_path):
    done = run("alpha=60,60,60", "resolution=16", f"out={tmp_path}")
    assert done.returncode == 0, done.stderr
    assert sorted(p.name for p in tmp_path.iterdir()) == [
        "drape.json", "drape.npz", "drape.ply", "drape.png"]
    figures = json.loads((tmp_path / "drape.json").read_text())
    assert figures["status"] == "converged" and figures["positive_definite"]
    assert figures["parameters"]["alpha_uN_m"] == {"warp": 60.0, "bias": 60.0, "weft": 60.0}
    assert 0 < figures["drape_coefficient"] < 1

    import trimesh

    mesh = trimesh.load(tmp_path / "drape.ply", process=False)
    assert mesh.vertices.shape == (256, 3)
    assert abs(mesh.vertices[:, 2].max()) < 1e-6 and mesh.vertices[:, 2].min() < -0.05


@pytest.mark.parametrize(
    "words",
    [["alpha=20,20"], ["alpha=20,x,20"], ["alpha=-1,20,20"], ["density=0"], ["colour=red"],
     ["resolution=2"], ["rig=table"], ["alpha"], ["start=wild"], ["offset=1"]],
    ids=lambda words: words[0],
)
def test_mistakes_end_with_one_line_and_code_2(tmp_path, words):
    done = run(*words, f"out={tmp_path / 'out'}")
    assert done.returncode == 2
    assert len(done.stderr.strip().splitlines()) == 1 and done.stderr.startswith("error: ")
    assert not (tmp_path / "out").exists()


def test_words_take_the_types_of_the_defaults():
    defaults = {"name": "a", "count": 1, "ratio": 1.0, "list": [1.0, 2.0], "any": None}
    words = ["name=/x y/=z", "count=3", "ratio=2", "list=[3,4.5]", "any=text"]
    assert parse_overrides(defaults, words) == {
        "name": "/x y/=z", "count": 3, "ratio": 2.0, "list": [3.0, 4.5], "any": "text"
    }


@pytest.mark.parametrize("word", ["count=1.5", "count=many", "ratio=[1]", "nothing=1", "count"])
def test_words_of_the_wrong_type_are_refused(word):
    with pytest.raises(InputError):
        parse_overrides({"count": 1, "ratio": 1.0}, [word])
