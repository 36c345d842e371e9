"""Scans: made-up ones, raw ones in any unit and orientation, surfaces that no cloth can take."""

import io
import re
import zipfile
from pathlib import Path

import numpy as np
import pytest
import trimesh
from cloths import scan_arrays, waves
from scipy.spatial.transform import Rotation

from apps.drape import read_borrowed
from common.errors import InputError
from common.findings import Finding, texts
from data.captures.raw_scans import read_raw_scan
from data.captures.scan_place import UNITS, ScannedPlate, plate_of_scan
from data.captures.scans import check_rim, read_scan, rim_steepness
from drapenet.surface.registration import read_shape
from sim.draping import Drape, drape
from sim.material import MICRO, Fabric
from sim.measures import projected_area
from sim.mesh.specimen import TOPOLOGIES
from sim.rig import DISC_RIG, SQUARE_RIG, Rig
from sim.scene import make_specimen

RULED = Path(__file__).parents[2] / ".." / "shared" / "scans"
"""Straight lines from the plate's rim to outlines of real drapes."""
RIG = Rig(plate_diameter=0.180)
Z_UP, Y_UP = np.eye(3), np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]])


def test_scan_comes_back_as_it_was_written(tmp_path):
    arrays = scan_arrays()
    np.savez(tmp_path / "cone.npz", **arrays)
    scan = read_scan(tmp_path / "cone.npz", RIG)
    assert scan.positions.dtype == np.float64 and scan.faces.dtype == np.int64
    np.testing.assert_array_equal(scan.positions, arrays["vertices"])
    np.testing.assert_array_equal(scan.faces, arrays["faces"])
    seen = np.pi * (0.09 + 0.06 * np.sqrt(0.5)) ** 2 - np.pi * 0.01**2
    assert projected_area(scan.positions, scan.faces) == pytest.approx(seen, rel=5e-3)


def damaged(kind: str) -> bytes:
    """An npz file with a damage for which zipfile, zlib or numpy raises another error."""
    file, arrays = io.BytesIO(), scan_arrays()
    np.savez_compressed(file, rest=arrays.pop("rest"), **arrays)
    content = bytearray(file.getvalue())
    listed = content.index(b"PK\x01\x02")  # the first array in the archive's table
    if kind == "packed":
        content[60:120] = b"\xff" * 60
    elif kind == "method":
        content[listed + 10] = 98
    elif kind == "password":
        content[listed + 8] |= 1
    else:
        header = b"{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000000, 3)}"
        if kind == "open":
            header = header.replace(b"False", b"(((((")
        file = io.BytesIO()
        with zipfile.ZipFile(file, "w") as archive:
            for name in ("vertices.npy", "rest.npy"):
                archive.writestr(name, b"\x93NUMPY\x01\x00" + bytes([len(header), 0]) + header)
        return file.getvalue()
    return bytes(content)


KINDS = ("packed", "method", "password", "huge", "open")


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04 torn", b"some text", b"\x93NUMPY\x01\x00",
                                     *map(damaged, KINDS)])
def test_files_that_are_no_npz_are_refused(tmp_path, content):
    (tmp_path / "bad.npz").write_bytes(content)
    with pytest.raises(InputError, match="cannot be read") as caught:
        read_scan(tmp_path / "bad.npz", RIG)
    assert "vertices, rest and faces" in str(caught.value)
    with pytest.raises(InputError, match=r"bad\.npz cannot be read .*drape\.npz"):
        read_borrowed(tmp_path / "bad.npz")


@pytest.fixture(scope="module")
def soft_drape() -> Drape:
    """A drape of soft cloth on the disc rig."""
    return drape(Fabric(np.full(3, 5 * MICRO)), rig=DISC_RIG, edge=4e-3)


def from_rim_to_hem(result: Drape) -> np.ndarray:
    """Vertices (V, 3), m, of a drape moved to straight lines from the plate's rim to its hem."""
    radius, rim = np.linalg.norm(result.rest, axis=1), RIG.plate_radius
    azimuth = np.arctan2(result.rest[:, 1], result.rest[:, 0])
    hem = radius > 0.999 * radius.max()
    ends = np.column_stack([np.interp(azimuth, azimuth[hem], column, period=2 * np.pi)
                            for column in result.positions[hem].T])
    feet = rim * np.column_stack([np.cos(azimuth), np.sin(azimuth), 0 * azimuth])
    share = np.clip((radius - rim) / (radius.max() - rim), 0, 1)[:, None]
    return np.where(share > 0, feet + (ends - feet) * share, result.positions)


@pytest.mark.parametrize("noise_mm", [0.0, 0.3])
def test_cloth_leaves_the_rim_without_a_kink_and_straight_lines_do_not(soft_drape, noise_mm):
    noise = np.random.default_rng(0).normal(0, 1e-3 * noise_mm, soft_drape.positions.shape)
    assert 0.2 < rim_steepness(soft_drape.positions + noise, RIG) < 0.6
    check_rim(soft_drape.positions + noise, Path("cloth.ply"), RIG)
    lines = from_rim_to_hem(soft_drape) + noise
    assert rim_steepness(lines, RIG) == pytest.approx(1.0, abs=0.05)
    with pytest.raises(InputError, match=r"lines\.ply: 1 to 5 mm .* at most 0\.85 is") as caught:
        check_rim(lines, Path("lines.ply"), RIG)
    assert "\n" not in str(caught.value)


def test_a_tilted_plate_and_a_missing_part_do_not_change_the_steepness(soft_drape):
    points, expected = soft_drape.positions, rim_steepness(soft_drape.positions, RIG)
    tilted = points + np.column_stack([0 * points[:, :2], 0.02 * points[:, 0] + 3e-3])
    assert rim_steepness(tilted, RIG) == pytest.approx(expected, abs=0.03)
    assert rim_steepness(points[points[:, 0] < 0.05], RIG) == pytest.approx(expected, abs=0.05)
    # A plate without cloth around it, and a narrow strip, decide nothing.
    for few in (points[np.hypot(*points[:, :2].T) < 0.085], points[np.abs(points[:, 0]) < 0.02]):
        assert np.isnan(rim_steepness(few, RIG))
        check_rim(few, Path("few.ply"), RIG)


@pytest.mark.parametrize("kind", ["npz", "ply"])
def test_a_file_with_a_kink_at_the_rim_is_refused(tmp_path, soft_drape, kind):
    file, points, faces = tmp_path / f"lines.{kind}", from_rim_to_hem(soft_drape), soft_drape.faces
    if kind == "npz":
        np.savez(file, vertices=points, rest=soft_drape.rest, faces=faces)
    else:
        trimesh.Trimesh(points, faces, process=False).export(file)
    with pytest.raises(InputError, match="it has a kink there"):
        read_shape(file, DISC_RIG)


@pytest.mark.skipif(not RULED.is_dir(), reason="no surfaces computed from outlines here")
def test_surfaces_computed_from_outlines_are_refused():
    files = sorted(RULED.glob("*.npz"))
    assert len(files) == 60
    for file in files:
        with pytest.raises(InputError, match="it has a kink there"):
            read_shape(file, RIG)


def test_an_archive_that_unpacks_to_more_than_a_scan_has_is_refused(tmp_path):
    header = b"\x93NUMPY\x01\x00v\x00{'descr': '<f8', 'fortran_order': False, 'shape': (%d, 3), }"
    for rows, stored in ((10**12, 100), (10**8, 80_000_000)):
        with zipfile.ZipFile(tmp_path / "bomb.npz", "w", zipfile.ZIP_DEFLATED) as archive:
            with archive.open("vertices.npy", "w", force_zip64=True) as member:
                member.write((header % rows).ljust(127) + b"\n")
                for _ in range(stored >> 20):
                    member.write(bytes(1 << 20))
        with pytest.raises(InputError, match="cannot be read"):
            read_scan(tmp_path / "bomb.npz", RIG)


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


@pytest.mark.parametrize("counted_back", [False, True])
def test_every_material_of_an_obj_is_read(tmp_path, cloth, counted_back):
    """Also in blocks of a face and its vertices, with numbers that count back from there."""
    points = ["v {} {} {}".format(*point) for point in cloth.vertices]
    lines = ["mtllib none.mtl", *([] if counted_back else points)]
    for k, face in enumerate(cloth.faces):
        lines += [f"usemtl m{k % 2}"] * (k % 500 == 0) + (
            [*(points[n] for n in face), "vn 0 0 1", "f -3//-1 -2//-1 -1//-1"] if counted_back else
            ["f {} {} {}".format(*face + 1)])
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
        plate = plate_of_scan(points / UNITS[unit], faces, draped.rig)
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
    assert ScannedPlate("m", tilted(3.0) @ [0, 0, 1.0], np.zeros(3)).tilt == pytest.approx(3.0)


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
