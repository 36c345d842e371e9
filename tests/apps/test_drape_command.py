"""``python -m apps.drape``: files, figures, and one line for a mistake."""

import json
import subprocess
import sys

import numpy as np

from apps.drape import main
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


def test_figures_of_a_failure_are_json(tmp_path, monkeypatch):
    monkeypatch.setattr("sim.material.ALPHA_RANGE", (0.0, np.inf))
    main(["alpha=1e300,1e300,1e300", "edge_mm=12", "start=sine", f"out={tmp_path}"])

    def refuse(word: str) -> None:
        raise ValueError(word)

    figures = json.loads((tmp_path / "drape.json").read_text(), parse_constant=refuse)
    assert figures["status"] == "not_finite" and figures["residual"] is None
