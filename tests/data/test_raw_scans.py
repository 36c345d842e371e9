"""Raw scans in any unit and orientation."""

import re

import numpy as np
import pytest
import trimesh
from cloths import waves

from common.errors import InputError
from data.captures.raw_scans import read_raw_scan
from sim.mesh.specimen import TOPOLOGIES
from sim.rig import DISC_RIG
from sim.scene import make_specimen

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
    scan = read_raw_scan(file, DISC_RIG)
    assert len(scan.points) == len(cloth.vertices)  # also of STL
    bounds = np.stack([scan.points.min(axis=0), scan.points.max(axis=0)])
    off = np.abs(bounds - cloth.bounds).max()
    assert off < (1e-6 if not change else 3.1e-3 if not note else 1.5e-3)
    assert bool(scan.notes) == bool(note) and re.search(note, "".join(scan.notes))


def test_every_material_of_an_obj_is_read(tmp_path, cloth):
    lines = ["mtllib none.mtl", *("v {} {} {}".format(*point) for point in cloth.vertices)]
    for k, face in enumerate(cloth.faces + 1):
        lines += [f"usemtl m{k % 2}"] * (k % 500 == 0) + ["f {} {} {}".format(*face)]
    (tmp_path / "scan.obj").write_text("\n".join(lines))
    scan = read_raw_scan(tmp_path / "scan.obj", DISC_RIG)
    assert scan.notes == () and len(scan.faces) == len(cloth.faces)
    assert trimesh.Trimesh(scan.points, scan.faces).area == pytest.approx(cloth.area)


def test_what_shows_no_plate_is_not_moved(tmp_path):
    rng = np.random.default_rng(0)
    trimesh.PointCloud(points := rng.normal(0, 0.05, (3000, 3))).export(tmp_path / "scan.ply")
    scan = read_raw_scan(tmp_path / "scan.ply", DISC_RIG)
    assert scan.notes == () and np.allclose(scan.points, points, atol=1e-6)


def with_nan(cloth: trimesh.Trimesh) -> trimesh.Trimesh:
    mesh = cloth.copy()
    mesh.vertices[3, 1] = np.nan
    return mesh


@pytest.mark.parametrize(("make", "message"), [
    (b"", "cannot be read"), (b"ply\nformat ascii 1.0\n", "export the scan again"),
    (b"\x00\xff" * 50, "export the scan again"),
    (b"v 0.1 0.2 0\n" * 300 + b"v 0.1 0.2\nf 1 2 3\n", "export the scan again"),
    (lambda cloth: moved(cloth, scale=5), "metres"),
    (lambda cloth: trimesh.Trimesh(cloth.vertices * [1, 1, 0], cloth.faces), "z must point up"),
    (with_nan, "1 of .* points are not finite"),
    (lambda cloth: trimesh.Trimesh(cloth.vertices, cloth.faces + np.array([0, 0, 10**6]),
                                   process=False), "refers to a missing vertex")])
def test_a_faulty_raw_scan_is_refused(tmp_path, cloth, make, message):
    file = tmp_path / ("scan.ply" if callable(make) or not make.startswith(b"v ") else "scan.obj")
    if callable(make):
        make(cloth).export(file)
    else:
        file.write_bytes(make)
    with pytest.raises(InputError, match=message):
        read_raw_scan(file, DISC_RIG)


def test_raw_scans_may_have_no_faces(tmp_path, cloth):
    trimesh.PointCloud(cloth.vertices).export(tmp_path / "scan.ply")
    scan = read_raw_scan(tmp_path / "scan.ply", DISC_RIG)
    assert len(scan.points) == len(cloth.vertices) and scan.faces.shape == (0, 3)
