"""Scans as scanners write them: meshes or clouds of points, in any unit and orientation."""

import io
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from common.documents import read_bytes, reading
from common.errors import InputError
from common.types import Faces, Points
from data.captures.scans import MAX_SCAN_SIZE
from sim.rig import Rig

RAW = (".ply", ".obj", ".stl")  # suffixes
MAX_BYTES = 256 << 20
MIN_POINTS = 200
UNITS = {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "inches": 0.0254}
MAX_OFFSET = 5e-3  # m, of a plate's centre; the measured centre is 1 mm off, at most 6 mm
_PLATE_TOLERANCE = 0.02  # m, maximum distance of the plate from the plane z = 0
_SAMPLED = 20_000  # points of a surface, to place it
_FLAT = 1.5e-3  # m, between the heights of points on the plate
_PLATE_RATIO = 0.85, 1.4  # of the flat part's radius over the plate's
_UPRIGHT = {up: cv2.Rodrigues(np.pi / 2 * np.array(turn))[0].round() for up, turn in {
    "z": (0.0, 0, 0), "y": (1.0, 0, 0), "x": (0, -1.0, 0), "-z": (2.0, 0, 0), "-y": (-1.0, 0, 0),
    "-x": (0, 1.0, 0)}.items()}
"""Turns that make axes point up, by axis; quarter turns about x or y."""


@dataclass(frozen=True)
class RawScan:
    """A scanned surface in metres, z up, the centre of the plate's top its origin; ``faces`` may be
    none, ``notes`` state what was measured and changed."""

    points: Points
    faces: Faces
    notes: tuple[str, ...] = ()


def read_raw_scan(path: Path, rig: Rig) -> RawScan:
    """Read a PLY, OBJ or STL file; unit, vertical and centre are measured from the flat plate."""
    with reading(path, "export the scan again as PLY, OBJ or STL"):
        scan = _placed(*_read(path), rig)
    if fault := _placement_fault(scan.points, rig):
        raise InputError(f"{path}: {fault}")
    return scan


def _read(path: Path) -> tuple[Points, Faces]:
    """Points and faces, merged; InputError for impossible ones, any error for a damaged file."""
    import trimesh

    data = read_bytes(path, MAX_BYTES, "scan")
    # From memory: files that a scan refers to, such as materials, must not be read.
    mesh: Any = trimesh.load(io.BytesIO(data), file_type=path.suffix[1:].lower(), process=False,
                        skip_materials=True)
    if isinstance(mesh, trimesh.Scene):  # a mesh for each material
        mesh = trimesh.util.concatenate(mesh.dump())
    points = np.asarray(mesh.vertices, dtype=np.float64)
    if points.shape[1:] != (3,):
        raise ValueError("points have another number of coordinates than three")
    faces = np.asarray(getattr(mesh, "faces", np.zeros((0, 3))), dtype=np.int64)
    if bad := int((~np.isfinite(points)).any(axis=1).sum()):
        raise InputError(f"{path}: {bad} of {len(points)} points are not finite numbers; "
                         "remove them")
    if len(faces):
        if not 0 <= faces.min() <= faces.max() < len(points):
            raise InputError(f"{path}: a face refers to a missing vertex; export the scan again")
        mesh.merge_vertices()  # STL has the corners of each triangle apart
        points, faces = np.asarray(mesh.vertices, dtype=np.float64), np.asarray(mesh.faces)
    if not MIN_POINTS <= len(points) <= MAX_SCAN_SIZE:
        raise InputError(f"{path} has {len(points)} points; a scan has {MIN_POINTS} to "
                         f"{MAX_SCAN_SIZE}")
    return points, faces


def _placed(points: Points, faces: Faces, rig: Rig) -> RawScan:
    """In metres, z up, at the plate; as it is where unit or plate are not recognised."""
    import trimesh

    cloud = points
    if len(faces):
        mesh = trimesh.Trimesh(points, faces, process=False)
        cloud = trimesh.sample.sample_surface(mesh, _SAMPLED, seed=0)[0]
    extent = np.ptp(cloud, axis=0).max()
    unit = next((name for name, metres in UNITS.items() if 0.9 * rig.plate_diameter < (
        metres * extent) < 1.1 * rig.specimen_size), None)
    if unit is None:
        return RawScan(points, faces)
    # The cloth on the plate is the largest level part with all else below it.
    tops = {up: _top(UNITS[unit] * cloud @ turn.T, rig) for up, turn in _UPRIGHT.items()}
    up = max(tops, key=lambda name: len(tops[name]))
    # The hull, because points may be denser at one side.
    hull = cv2.moments(cv2.convexHull(tops[up][:, :2].astype(np.float32)))
    if not _PLATE_RATIO[0] < np.sqrt(hull["m00"] / np.pi) / rig.plate_radius < _PLATE_RATIO[1]:
        return RawScan(points, faces)
    centre = np.array([hull["m10"] / hull["m00"], hull["m01"] / hull["m00"],
                       np.median(tops[up][:, 2])])
    centre *= np.linalg.norm(centre) > MAX_OFFSET
    notes = [f"lengths in {unit}"] * (unit != "m") + [f"{up} up"] * (up != "z")
    if centre.any():
        notes.append(f"the plate's centre {1e3 * np.linalg.norm(centre):.0f} mm from the origin")
    return RawScan(
        UNITS[unit] * points @ _UPRIGHT[up].T - centre, faces,
        (f"the scan has {', '.join(notes)}, as its flat part shows, and was brought to metres, z "
         "up, the plate's centre at the origin",) * bool(notes))


def _top(points: Points, rig: Rig) -> np.ndarray:
    """Points (M, 3), m, that are as high as a plate of ``rig`` is if the highest lie on it."""
    height, share = points[:, 2], (rig.plate_diameter / rig.specimen_size) ** 2
    return points[np.abs(height - np.quantile(height, 1 - share / 2)) < _FLAT]


def _placement_fault(points: Points, rig: Rig) -> str:
    """What is wrong with the place of a scan; empty if nothing is."""
    reach = np.abs(points).max()
    if not 0.5 * rig.plate_radius < reach < rig.specimen_size:
        return ("points must be in metres, the plate's centre the origin; they reach "
                f"{reach:.3g} from it, a specimen {rig.specimen_size / 2:g} m")
    middle = points[np.hypot(points[:, 0], points[:, 1]) < 0.8 * rig.plate_radius, 2]
    if not len(middle):
        return "no point lies on the plate; move its centre to the origin"
    if (off := np.abs(np.median(middle))) > _PLATE_TOLERANCE:
        return (f"cloth on the plate lies {1e3 * off:.3g} mm from the plane z = 0 (median), at "
                f"most {1e3 * _PLATE_TOLERANCE:g} mm is allowed; move the plate's top to z = 0, "
                "with z pointing up")
    return "" if points[:, 2].min() <= -_PLATE_TOLERANCE else (
        f"no point lies {1e3 * _PLATE_TOLERANCE:g} mm below the support; z must point up, in "
        f"metres, and the specimen must be of {rig.name}")
