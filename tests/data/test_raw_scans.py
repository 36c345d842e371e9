"""Raw scans in any unit and orientation, off level, with tables, with gaps."""

import re

import numpy as np
import pytest
import trimesh
from cloths import waves
from scipy.spatial.transform import Rotation

from common.errors import InputError
from common.findings import Finding, texts
from data.captures.raw_scans import read_raw_scan
from data.captures.scan_place import UNITS, Plate, find_plate
from sim.draping import Drape, drape
from sim.material import MICRO, Fabric
from sim.mesh.specimen import TOPOLOGIES
from sim.rig import DISC_RIG, SQUARE_RIG
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
    (".stl", {"scale": 1 / 0.3048}, "lengths in feet"), (".ply", {"scale": 1e6}, "lengths in µm"),
    (".glb", {"turn": Y_UP}, "has y up"), (".ply", {"centre": (0, 0, 2e-3)}, "2.0 mm from the"),
    (".obj", {"turn": Y_UP}, "has y up"), (".ply", {"turn": np.diag([1, -1, -1])}, "has -z up"),
    (".ply", {"centre": (0, 6e-3, 0)}, "the plate's centre [56] mm from the origin"),
    (".stl", {"scale": 1e3, "turn": Y_UP, "centre": (0.3, 0.2, 0.1)},
     r"lengths in mm, as .* has y up, as .* the plate's centre 37\d mm")])
def test_unit_orientation_and_place_are_measured(tmp_path, cloth, suffix, change, note):
    file = tmp_path / f"scan{suffix}"
    moved(cloth, **change).export(file)
    scan = read_raw_scan(file, DISC_RIG)
    assert len(scan.points) == len(cloth.vertices)  # also of STL
    said = "".join(texts(scan.warnings))
    assert "°" not in said
    bounds = np.stack([scan.points.min(axis=0), scan.points.max(axis=0)])
    off = np.abs(bounds - cloth.bounds).max()
    assert off < (1e-6 if not change else 3.1e-3 if not note else 1.5e-3)
    assert bool(scan.warnings) == bool(note) and re.search(note, said)


def test_every_material_of_an_obj_is_read(tmp_path, cloth):
    lines = ["mtllib none.mtl", *("v {} {} {}".format(*point) for point in cloth.vertices)]
    for k, face in enumerate(cloth.faces + 1):
        lines += [f"usemtl m{k % 2}"] * (k % 500 == 0) + ["f {} {} {}".format(*face)]
    (tmp_path / "scan.obj").write_text("\n".join(lines))
    scan = read_raw_scan(tmp_path / "scan.obj", DISC_RIG)
    assert scan.warnings == () and len(scan.faces) == len(cloth.faces)
    assert trimesh.Trimesh(scan.points, scan.faces).area == pytest.approx(cloth.area)


def tilted(degrees: float, azimuth: float = 0.7) -> np.ndarray:
    """Rotation (3, 3) about a level axis."""
    axis = [np.cos(azimuth), np.sin(azimuth), 0.0]
    return Rotation.from_rotvec(np.radians(degrees) * np.array(axis)).as_matrix()


SPECIMENS = {  # moduli, µN·m; density, kg/m²; tester
    "limp": ((5, 4, 4), 0.15, DISC_RIG), "chiffon": ((2, 1.4, 1.5), 0.04, DISC_RIG),
    "stiff": ((300, 180, 150), 0.4, DISC_RIG), "nearly flat": ((900, 800, 700), 0.3, DISC_RIG),
    "square": ((48, 30, 22), 0.21, SQUARE_RIG)}


@pytest.fixture(scope="module", params=SPECIMENS)
def draped(request) -> Drape:
    alpha, density, rig = SPECIMENS[request.param]
    result = drape(Fabric(MICRO * np.array(alpha), density=density), rig=rig, edge=6e-3)
    assert result.converged
    return result


def test_a_tilted_scan_is_levelled_at_every_axis_up(draped):
    rng = np.random.default_rng(0)
    held = np.linalg.norm(draped.rest, axis=1) < 0.95 * draped.rig.plate_radius
    for unit, up, degrees, faces in zip(
            UNITS, ("z", "y", "x", "-z", "-y", "-x"), (1.0, 9.7, 5.0, 0.6, 3.0, 8.0),
            2 * [draped.faces, draped.faces[:0], draped.faces], strict=True):
        noisy = draped.positions + rng.normal(0, 3e-4, draped.positions.shape)
        upright = np.roll(np.eye(3), "zxy".index(up[-1]), axis=1).T * (-1 if "-" in up else 1)
        turn = upright @ tilted(degrees, rng.uniform(0, 6))
        points = noisy @ turn.T + rng.uniform(-0.3, 0.3, 3)
        plate = find_plate(points / UNITS[unit], faces, draped.rig)
        placed, changes = plate.placed(points / UNITS[unit])
        assert (plate.unit, plate.up) == (unit, up)
        assert plate.tilt == pytest.approx(degrees, abs=0.3)
        assert Finding("scan_tilted", {"value": plate.tilt}) in changes
        flat = placed[held] - placed[held].mean(axis=0)
        assert np.degrees(np.arccos(abs(np.linalg.svd(flat)[2][2, 2]))) < 0.3
        assert np.abs(placed[held].mean(axis=0)[:2]).max() < 5e-3
        assert abs(placed[held].mean(axis=0)[2]) < 0.5e-3


def test_a_tilt_moves_no_centre_and_a_large_one_is_refused(tmp_path, cloth):
    for degrees in (2.0, 5.0):
        moved(cloth, turn=tilted(degrees)).export(tmp_path / "scan.ply")
        scan = read_raw_scan(tmp_path / "scan.ply", DISC_RIG)
        assert texts(scan.warnings) == [f"the scan has the plate tilted by {degrees:.1f}°, as its "
                                        "flat part shows, and was levelled"]
        assert np.abs(scan.points - cloth.vertices).max() < 0.2e-3
    moved(cloth, turn=tilted(14.0)).export(tmp_path / "scan.ply")
    with pytest.raises(InputError, match=r"tilted by 14° against the axis z, at most 10° .* level"):
        read_raw_scan(tmp_path / "scan.ply", DISC_RIG)
    assert Plate("m", tilted(3.0) @ [0, 0, 1.0], np.zeros(3)).tilt == pytest.approx(3.0)


PILLAR = trimesh.creation.cylinder(0.03, 0.19).subdivide().apply_translation([0, 0, -0.12])
TURNTABLE = trimesh.creation.cylinder(0.12, 0.02).subdivide().apply_translation([0, 0, -0.19])
SCENES = {
    "table": [trimesh.creation.box((0.8, 0.9, 1e-4))], "pillar": [PILLAR],
    "all": [trimesh.creation.box((0.8, 0.9, 1e-4)), PILLAR, TURNTABLE]}


@pytest.mark.parametrize("faces", [True, False])
@pytest.mark.parametrize("scene", SCENES)
def test_what_is_not_cloth_is_cut_away(tmp_path, cloth, scene, faces):
    around = [part.copy() for part in SCENES[scene]]
    if scene != "pillar":
        around[0].apply_translation([0.05, 0, -0.21])
    whole = moved(trimesh.util.concatenate([cloth, *around]), scale=1e3, turn=tilted(4.0))
    if not faces:
        number = int(whole.area / 9)  # a point every 3 mm
        whole = trimesh.PointCloud(trimesh.sample.sample_surface(whole, number, seed=0)[0])
    whole.export(tmp_path / "scan.ply")
    scan = read_raw_scan(tmp_path / "scan.ply", DISC_RIG)
    assert np.abs(scan.points.min(axis=0) - cloth.vertices.min(axis=0)).max() < 3e-3
    assert np.abs(scan.points.max(axis=0) - cloth.vertices.max(axis=0)).max() < 3e-3
    unit, level, *cut = scan.warnings
    assert "the plate tilted by 4.0°" in level.text and unit.values == {"unit": "mm"}
    assert cut and all("are not cloth and were cut away: " in line for line in texts(cut))
    assert sum(one.values["value"] for one in cut) == cut[0].values["points"] - len(scan.points)
    assert not faces or len(scan.points) == len(cloth.vertices)
    assert faces or ("the table 210 mm below the plate" in "".join(texts(cut))) == (
        scene != "pillar")


def without(cloth: trimesh.Trimesh, gone: np.ndarray) -> trimesh.Trimesh:
    mesh = cloth.copy()
    mesh.update_faces(~gone[mesh.faces].any(axis=1))
    mesh.remove_unreferenced_vertices()
    return mesh


@pytest.mark.parametrize(("share", "unseen"), [(0.0, ""), (0.5, r"[23]\d%"), (0.75, r"[5678]\d%")])
def test_the_plate_is_filled_where_its_rim_shows_its_plane(tmp_path, draped, share, unseen):
    if draped.rig != DISC_RIG:
        pytest.skip("commands read scans of the disc rig alone; smaller plates are untested")
    mesh = trimesh.Trimesh(draped.positions, draped.faces, process=False)
    plate = draped.rig.plate_radius
    hole = without(mesh, np.linalg.norm(draped.rest, axis=1) < share * plate)
    moved(hole, turn=tilted(3.0)).export(tmp_path / "scan.ply")
    scan = read_raw_scan(tmp_path / "scan.ply", draped.rig)
    assert np.abs(scan.points[: len(hole.vertices)] - hole.vertices).max() < 0.5e-3
    assert re.search(f"no points on {unseen} of the plate" if unseen else "level",
                     scan.warnings[-1].text)
    filled = trimesh.Trimesh(scan.points, scan.faces, process=False)
    assert filled.area == pytest.approx(mesh.area, rel=0.1)


def test_without_its_rim_the_plate_is_not_known(tmp_path, cloth):
    radius = np.hypot(*cloth.vertices[:, :2].T)
    without(cloth, radius < 1.1 * DISC_RIG.plate_radius).export(tmp_path / "scan.ply")
    with pytest.raises(InputError, match=r"no plate of 180 mm .* at least around its rim"):
        read_raw_scan(tmp_path / "scan.ply", DISC_RIG)


def test_what_shows_no_plate_is_refused(tmp_path):
    rng = np.random.default_rng(0)
    trimesh.PointCloud(rng.normal(0, 0.05, (3000, 3))).export(tmp_path / "scan.ply")
    with pytest.raises(InputError, match=r"scan\.ply: no plate of 180 mm .* was found"):
        read_raw_scan(tmp_path / "scan.ply", DISC_RIG)


def test_raw_scans_may_have_no_faces(tmp_path, cloth):
    trimesh.PointCloud(cloth.vertices).export(tmp_path / "scan.ply")
    scan = read_raw_scan(tmp_path / "scan.ply", DISC_RIG)
    assert len(scan.points) == len(cloth.vertices) and scan.faces.shape == (0, 3)
