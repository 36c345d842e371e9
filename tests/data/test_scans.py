"""Reading scanned drapes: a made-up scan, broken ones, and surfaces that no cloth can take."""

import io
import zipfile
from pathlib import Path

import numpy as np
import pytest
import trimesh
from cloths import revolved

from apps.drape_file import read_borrowed
from common.errors import InputError
from data.captures.scans import check_rim, read_scan, rim_steepness
from drapenet.surface.registration import read_shape
from sim.draping import Drape, drape
from sim.material import MICRO, Fabric
from sim.measures import projected_area
from sim.rig import DISC_RIG, Rig

RULED = Path(__file__).parents[2] / ".." / "shared" / "scans"
"""Straight lines from the plate's rim to outlines of real drapes."""
RIG = Rig(plate_diameter=0.180)


def scan_arrays() -> dict[str, np.ndarray]:
    """A disc of rings whose overhang hangs down along a cone of 45°."""
    radius = np.linspace(0.01, 0.15, 15)
    over = np.maximum(radius - 0.09, 0)
    rest, faces = revolved(radius, 0 * radius, around=60)
    vertices, _ = revolved(radius - (1 - np.sqrt(0.5)) * over, -np.sqrt(0.5) * over, around=60)
    return {"vertices": vertices.astype(np.float32), "rest": rest[:, :2].astype(np.float32),
            "faces": faces.astype(np.int32)}


def test_scan_comes_back_as_it_was_written(tmp_path):
    arrays = scan_arrays()
    np.savez(tmp_path / "cone.npz", **arrays)
    scan = read_scan(tmp_path / "cone.npz", RIG)
    assert scan.positions.dtype == np.float64 and scan.faces.dtype == np.int64
    np.testing.assert_array_equal(scan.positions, arrays["vertices"])
    np.testing.assert_array_equal(scan.faces, arrays["faces"])
    seen = np.pi * (0.09 + 0.06 * np.sqrt(0.5)) ** 2 - np.pi * 0.01**2
    assert projected_area(scan.positions, scan.faces) == pytest.approx(seen, rel=5e-3)


@pytest.mark.parametrize(("change", "complaint"), [
    (lambda a: a.pop("rest"), "no array 'rest'"),
    (lambda a: a.update(rest=a["rest"][:-1]), r"rest \(V, 2\)"),
    (lambda a: a.update(vertices=np.float64(3.0)), r"vertices must be \(V, 3\)"),
    (lambda a: a.update(faces=a["faces"] + 1), "1 to 900; they are numbered from 0 to 899"),
    (lambda a: a.update(faces=np.concatenate([a["faces"], a["faces"][:1, [1, 2, 0]]])), "twice"),
    (lambda a: a.update(faces=a["faces"] * 1.0), "type float64; they must be whole"),
    (lambda a: a.update(faces=a["faces"][:0]), "and 0 triangles"),
    (lambda a: a.update(faces=a["faces"][:, ::-1]), "counter-clockwise"),
    (lambda a: a.update(faces=a["faces"][a["faces"].min(axis=1) > 0]), "belongs to no face"),
    (lambda a: a.update(vertices=a["vertices"] * np.nan), "finite"),
    (lambda a: a.update(vertices=a["vertices"].astype(object)), "cannot be read"),
    (lambda a: a.update({k: 1e3 * a[k] for k in ("vertices", "rest")}), "in metres"),
    (lambda a: a.update(vertices=1e3 * a["vertices"]), "must both be in metres"),
    (lambda a: a.update(vertices=a["vertices"] / 25.4), "must both be in metres"),
    (lambda a: a.pop("faces"), "with vertices, rest and faces"),
    (lambda a: a.update(vertices=a["vertices"][:, [0, 2, 1]]), "at most 5 mm"),
    (lambda a: a.update(vertices=a["vertices"] * [1, 1, -1]), "below the support"),
])
def test_what_is_no_scan_is_refused_in_one_line(tmp_path, change, complaint):
    arrays = scan_arrays()
    change(arrays)
    np.savez(tmp_path / "bad.npz", **arrays)
    with pytest.raises(InputError, match=complaint) as caught:
        read_scan(tmp_path / "bad.npz", RIG)
    assert "bad.npz" in str(caught.value) and "\n" not in str(caught.value)


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
