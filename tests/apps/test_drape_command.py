"""``python -m apps.drape``: files, figures, and one line for a mistake."""

import json
import subprocess
import sys

import numpy as np
import pytest

from apps.drape import main
from common.command import run_command
from common.errors import InputError
from sim.rig import Rig
from sim.scene import make_specimen


def test_writes_mesh_picture_and_figures(tmp_path):
    command = [sys.executable, "-m", "apps.drape", "alpha=60,60,60", "edge_mm=12"]
    done = subprocess.run([*command, f"out={tmp_path}"], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert sorted(p.name for p in tmp_path.iterdir()) == [
        "drape.json", "drape.npz", "drape.ply", "drape.png"]
    figures = json.loads((tmp_path / "drape.json").read_text())
    assert figures["status"] == "converged" and figures["positive_definite"]
    assert figures["parameters"]["alpha_uN_m"] == {"warp": 60.0, "bias": 60.0, "weft": 60.0}
    assert 0 < figures["drape_coefficient"] < 1
    assert figures["parameters"]["edge_mm"] == 12 and figures["coarser_meshes"] == ["converged"]

    import trimesh

    mesh = trimesh.load(tmp_path / "drape.ply", process=False)
    specimen = make_specimen(Rig(), edge=0.012).mesh
    np.testing.assert_array_equal(mesh.faces, specimen.faces)
    assert len(mesh.vertices) == len(specimen.rest)
    assert abs(mesh.vertices[:, 2].max()) < 1e-6 and mesh.vertices[:, 2].min() < -0.05


@pytest.mark.parametrize("word", [
    "alpha=20,20", "alpha=20,x,20", "alpha=-1,20,20", "density=0", "density=0.21", "colour=red",
    "edge_mm=0.2", "edge_mm=0", "rig=table", "alpha", "start=wild", "offset=1"])
def test_mistakes_end_with_one_line_and_code_2(tmp_path, monkeypatch, capsys, word):
    monkeypatch.setattr(sys, "argv", ["drape", word, f"out={tmp_path / 'out'}"])
    with pytest.raises(SystemExit) as ending:
        run_command(main)
    error = capsys.readouterr().err
    assert ending.value.code == 2 and error.startswith("error: ") and error.count("\n") == 1
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("out", ["/proc/drape", "FILE", "FILE/below", ""])
def test_a_place_that_cannot_be_written_to_is_told_before_the_drape(tmp_path, monkeypatch, out):
    (tmp_path / "file").write_text("mine")
    monkeypatch.setattr("apps.drape.drape", None)
    with pytest.raises(InputError, match="folder"):
        main([f"out={out.replace('FILE', str(tmp_path / 'file'))}"])


def test_figures_of_a_failure_are_json(tmp_path, monkeypatch):
    monkeypatch.setattr("sim.material.ALPHA_RANGE", (0.0, np.inf))
    main(["alpha=1e300,1e300,1e300", "edge_mm=12", "start=sine", f"out={tmp_path}"])

    def refuse(word: str) -> None:
        raise ValueError(word)

    figures = json.loads((tmp_path / "drape.json").read_text(), parse_constant=refuse)
    assert figures["status"] == "not_finite" and figures["residual"] is None
