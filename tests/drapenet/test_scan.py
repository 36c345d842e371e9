"""Raw scans in any unit and orientation."""

from pathlib import Path

import numpy as np
import pytest
import trimesh
from cloths import waves

import drapenet.scan
from common.errors import InputError
from data.captures.description import Specimen
from data.captures.scans import read_placed
from drapenet.scan import read_scan
from sim.mesh.specimen import TOPOLOGIES
from sim.rig import DISC_RIG
from sim.scene import make_specimen

SPECIMEN = Specimen(density_g_m2=210.0)
Z_UP, Y_UP = np.eye(3), np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]])


@pytest.fixture(scope="module")
def cloth() -> trimesh.Trimesh:
    mesh = make_specimen(DISC_RIG, edge=5e-3, topology=1 % TOPOLOGIES).mesh
    return trimesh.Trimesh(waves(mesh.rest, folds=5), mesh.faces, process=False)


def moved(cloth: trimesh.Trimesh, *, scale: float = 1.0, turn: np.ndarray = Z_UP,
          centre: tuple[float, ...] = (0, 0, 0)) -> trimesh.Trimesh:
    return trimesh.Trimesh(scale * (cloth.vertices @ turn.T + centre), cloth.faces, process=False)


@pytest.mark.parametrize(("suffix", "change", "note"), [
    (".ply", {}, ""), (".stl", {}, ""), (".obj", {"centre": (3e-3, 0, 0)}, ""),
    (".ply", {"scale": 1e3}, "lengths in mm, as"), (".stl", {"scale": 100}, "lengths in cm, as"),
    (".obj", {"scale": 1 / 0.0254}, "lengths in inches, as"),
    (".obj", {"turn": Y_UP}, "has y up"), (".ply", {"turn": np.diag([1, -1, -1])}, "has -z up"),
    (".ply", {"centre": (0, 6e-3, 0)}, "the plate's centre [56] mm from the origin"),
    (".stl", {"scale": 1e3, "turn": Y_UP, "centre": (0.3, 0.2, 0.1)},
     r"lengths in mm, y up, the plate's centre 37\d mm")])
def test_unit_orientation_and_place_are_measured(tmp_path, cloth, suffix, change, note):
    file = tmp_path / f"scan{suffix}"
    moved(cloth, **change).export(file)
    mesh, notes = read_placed(file, DISC_RIG)
    assert len(mesh.vertices) == len(cloth.vertices)  # also of STL
    off = np.abs(mesh.bounds - cloth.bounds).max()
    assert off < (1e-6 if not change else 3.1e-3 if not note else 1.5e-3)
    assert bool(notes) == bool(note)
    if note:
        with pytest.raises(InputError, match=note):
            raise InputError(notes[0])


def test_every_material_of_an_obj_is_read(tmp_path, cloth):
    lines = ["mtllib none.mtl", *("v {} {} {}".format(*point) for point in cloth.vertices)]
    for k, face in enumerate(cloth.faces + 1):
        lines += [f"usemtl m{k % 2}"] * (k % 500 == 0) + ["f {} {} {}".format(*face)]
    (tmp_path / "scan.obj").write_text("\n".join(lines))
    mesh, notes = read_placed(tmp_path / "scan.obj", DISC_RIG)
    assert notes == () and len(mesh.faces) == len(cloth.faces)
    assert mesh.area == pytest.approx(cloth.area)


@pytest.mark.parametrize("points", [
    np.random.default_rng(0).normal(0, 0.05, (3000, 3)), np.full((300, 3), np.nan),
    np.random.default_rng(0).uniform(0, 2, (300, 3))])
def test_what_shows_no_plate_is_left_as_it_is(tmp_path, points):
    trimesh.PointCloud(points).export(tmp_path / "scan.ply")
    mesh, notes = read_placed(tmp_path / "scan.ply", DISC_RIG)
    assert notes == () and np.allclose(mesh.vertices, points, atol=1e-6, equal_nan=True)


def test_the_placed_scan_is_registered_under_the_name_of_its_file(tmp_path, cloth, monkeypatch):
    file = tmp_path / "scan.stl"
    moved(cloth, scale=1e3).export(file)

    def refuse(path: Path, specimen: Specimen) -> None:
        found = trimesh.load(path, process=False)
        assert np.abs(found.bounds - cloth.bounds).max() < 1e-6 and specimen is SPECIMEN
        raise InputError(f"{path}: it has a kink")

    monkeypatch.setattr(drapenet.scan, "read_scan_capture", refuse)
    with pytest.raises(InputError, match=r"scan\.stl: it has a kink") as raised:
        read_scan(file, SPECIMEN)
    assert str(raised.value).startswith(str(file))
    (tmp_path / "torn.ply").write_bytes(b"ply\nformat ascii 1.0\n")
    with pytest.raises(InputError, match="export the scan again as PLY, OBJ or STL"):
        read_scan(tmp_path / "torn.ply", SPECIMEN)
