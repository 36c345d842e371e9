"""Meshes of scanned drapes on the disc rig, and a check of their shape at the plate's rim."""

import io
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np

from common.documents import read_arrays, read_bytes, reading
from common.errors import InputError
from common.types import Faces, Points, RestPoints
from sim.mesh import Mesh
from sim.rig import Rig

if TYPE_CHECKING:
    import trimesh

RAW = (".ply", ".obj", ".stl")  # suffixes of scans without rest coordinates
MAX_RAW_BYTES = 256 << 20  # bytes
UNITS = {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "inches": 0.0254}
MAX_OFFSET = 5e-3  # m, of a plate's centre; the measured centre is 1 mm off, at most 6 mm
MAX_SCAN_SIZE = 1_000_000  # vertices or triangles
MAX_RIM_STEEPNESS = 0.85
"""Of :func:`rim_steepness`: at most 0.76 in scans of 216 simulated drapes with all nuisances, 0.94
or more for straight lines from rim to hem."""
_NEAR = (1e-3, 5e-3)  # m, from the rim
_SECTORS, _MIN_SECTORS = 36, 12  # of azimuth, all and at least measured
_PLANE_TOLERANCE = 5e-3  # m, of cloth on the support
_SAMPLED = 20_000  # points of a surface, to place it
_FLAT = 1.5e-3  # m, between the heights of points on the plate
_PLATE_RATIO = 0.85, 1.4  # of the flat part's radius over the plate's
_UPRIGHT = {up: cv2.Rodrigues(np.pi / 2 * np.array(turn))[0].round() for up, turn in {
    "z": (0.0, 0, 0), "y": (1.0, 0, 0), "x": (0, -1.0, 0), "-z": (2.0, 0, 0), "-y": (-1.0, 0, 0),
    "-x": (0, 1.0, 0)}.items()}
"""Turns that make axes point up, by axis; quarter turns about x or y."""
_MAX_RADIUS_RATIO = 1.02  # of rest points over the specimen's radius
_MAX_EDGE_RATIO = 2.0  # between draped and rest lengths of edges; with wrong units it exceeds 20


@dataclass(frozen=True)
class Scan:
    """A scanned drape; z up, the support's top at z = 0, its axis through the origin."""

    positions: Points
    rest: RestPoints
    faces: Faces


def read_scan(path: Path, rig: Rig) -> Scan:
    """Read an npz file with ``vertices`` (V, 3) m, ``rest`` (V, 2) m and ``faces`` (F, 3)."""
    arrays = read_arrays(path, ("vertices", "rest", "faces"), expected=(
        "an npz file of a scan with vertices, rest and faces; a raw mesh must end in .ply or .obj"))
    positions, rest, faces = arrays["vertices"], arrays["rest"], arrays["faces"]
    if fault := (_array_fault(positions, rest, faces) or _mesh_fault(rest, faces)
                 or _placement_fault(positions, rest, faces, rig)):
        raise InputError(f"{path}: {fault}")
    return Scan(positions.astype(np.float64), rest.astype(np.float64), faces.astype(np.int64))


def read_placed(path: Path, rig: Rig) -> "tuple[trimesh.Trimesh, tuple[str, ...]]":
    """A raw scan in metres, z up, the centre of the plate's top its origin, and a note of what was
    measured for that; as it is in the file where unit or plate are not recognised.
    """
    import trimesh

    data = read_bytes(path, MAX_RAW_BYTES, "scan")
    with reading(path, "export the scan again as PLY, OBJ or STL"):
        # From memory: files that a scan refers to, such as materials, must not be read.
        mesh = trimesh.load(io.BytesIO(data), file_type=path.suffix[1:].lower(), process=False,
                            skip_materials=True)
        if isinstance(mesh, trimesh.Scene):  # a mesh for each material
            mesh = trimesh.util.concatenate(mesh.dump())
        cloud = np.asarray(mesh.vertices).reshape(-1, 3)
        if len(getattr(mesh, "faces", ())) and np.isfinite(cloud).all():
            mesh.merge_vertices()  # STL has the corners of each triangle apart
            cloud = trimesh.sample.sample_surface(mesh, _SAMPLED, seed=0)[0]
    extent = np.ptp(cloud, axis=0).max() if len(cloud) else 0.0
    unit = next((name for name, metres in UNITS.items() if 0.9 * rig.plate_diameter < (
        metres * extent) < 1.1 * rig.specimen_size), None)
    if unit is None:
        return mesh, ()
    # The cloth on the plate is the largest level part with all else below it.
    tops = {up: _top(UNITS[unit] * cloud @ turn.T, rig) for up, turn in _UPRIGHT.items()}
    up = max(tops, key=lambda name: len(tops[name]))
    # The hull, because points may be denser at one side.
    hull = cv2.moments(cv2.convexHull(tops[up][:, :2].astype(np.float32)))
    if not _PLATE_RATIO[0] < np.sqrt(hull["m00"] / np.pi) / rig.plate_radius < _PLATE_RATIO[1]:
        return mesh, ()
    centre = np.array([hull["m10"] / hull["m00"], hull["m01"] / hull["m00"],
                       np.median(tops[up][:, 2])])
    centre *= np.linalg.norm(centre) > MAX_OFFSET
    mesh.vertices = UNITS[unit] * mesh.vertices @ _UPRIGHT[up].T - centre
    notes = [f"lengths in {unit}"] * (unit != "m") + [f"{up} up"] * (up != "z")
    if centre.any():
        notes.append(f"the plate's centre {1e3 * np.linalg.norm(centre):.0f} mm from the origin")
    return mesh, (f"the scan has {', '.join(notes)}, as its flat part shows, and was brought to "
                  "metres, z up, the plate's centre at the origin",) * bool(notes)


def _top(points: Points, rig: Rig) -> Points:
    """The points that are as high as a plate of ``rig`` is if the highest points lie on it."""
    height, share = points[:, 2], (rig.plate_diameter / rig.specimen_size) ** 2
    return points[np.abs(height - np.quantile(height, 1 - share / 2)) < _FLAT]


def _array_fault(positions: np.ndarray, rest: np.ndarray, faces: np.ndarray) -> str:
    """What is wrong with shapes and types; empty if nothing is, as in the functions below."""
    count = len(positions) if positions.ndim else 0
    if (positions.shape, rest.shape) != ((count, 3), (count, 2)) or faces.shape[1:] != (3,):
        return (f"arrays have the shapes {positions.shape}, {rest.shape} and {faces.shape}; "
                "vertices must be (V, 3), rest (V, 2) and faces (F, 3)")
    if not 3 <= count <= MAX_SCAN_SIZE or not 1 <= len(faces) <= MAX_SCAN_SIZE:
        return (f"it has {count} vertices and {len(faces)} triangles; a scan has 3 to "
                f"{MAX_SCAN_SIZE} vertices and at most as many triangles")
    if faces.dtype.kind not in "iu":
        return f"faces have the type {faces.dtype}; they must be whole numbers"
    if not all(a.dtype.kind in "fiu" and np.isfinite(a).all() for a in (positions, rest)):
        return "vertices and rest must be finite numbers"
    return ""


def _mesh_fault(rest: RestPoints, faces: Faces) -> str:
    if faces.min() < 0 or faces.max() >= len(rest):
        return (f"faces refer to the vertices {faces.min()} to {faces.max()}; they are numbered "
                f"from 0 to {len(rest) - 1}: export the mesh again")
    if len(np.unique(np.sort(faces, axis=1), axis=0)) < len(faces):
        return "the same face is given twice; leave repeated faces out"
    mesh = Mesh(rest.astype(np.float64), faces.astype(np.int64))
    if not (mesh.areas > 0).all():
        return ("the corners of each face must run counter-clockwise on the flat specimen; reverse "
                "their order where they do not")
    return "" if mesh.vertex_areas.all() else (
        "a vertex belongs to no face; leave such vertices out")


def _placement_fault(positions: Points, rest: RestPoints, faces: Faces, rig: Rig) -> str:
    radius, largest = np.linalg.norm(rest, axis=1), rig.specimen_size / 2
    if not 0.9 * largest < radius.max() < _MAX_RADIUS_RATIO * largest:
        return (f"the flat specimen must be a disc of {1e3 * largest:g} mm radius around the "
                f"origin, in metres; it reaches {1e3 * radius.max():g} mm")
    corners = faces, np.roll(faces, 1, axis=1)
    draped, flat = (np.linalg.norm(points[corners[0]] - points[corners[1]], axis=2).mean()
                    for points in (positions, rest))
    if draped > _MAX_EDGE_RATIO * flat or flat > _MAX_EDGE_RATIO * draped:
        return (f"vertices and rest must both be in metres; the mesh's edges are {1e3 * draped:.3g}"
                f" mm long, on the flat specimen {1e3 * flat:.3g} mm")
    height = positions[:, 2]
    supported = radius < 0.9 * rig.plate_radius
    off = np.abs(height[supported]).max() if supported.any() else np.inf
    if off > _PLANE_TOLERANCE:
        return (f"cloth on the support lies up to {1e3 * off:.3g} mm from the plane z = 0, at most "
                f"{1e3 * _PLANE_TOLERANCE:g} mm is allowed; move the support's top to z = 0, with "
                "z pointing up")
    return "" if height.min() <= -_PLANE_TOLERANCE else (
        "no vertex lies below the support; z must point up (in metres)")


def rim_steepness(points: Points, rig: Rig) -> float:
    """Steepness of a surface, in the axes of :class:`Scan`, just outside the plate's rim, over that
    of its outer half; NaN if less than a third of the sectors have points in both.

    Steepness is the angle of chords below the plate, from the rim to the surface at the same
    azimuth, averaged over sectors of azimuth. Cloth held by a plate leaves it horizontally, and its
    slope grows over a length comparable with the bending length, so that the ratio is well below 1.
    """
    radius = np.hypot(points[:, 0], points[:, 1])
    plane = np.column_stack([points[:, :2], np.ones(len(points))])
    on_plate = radius < 0.95 * rig.plate_radius
    tilt = np.linalg.lstsq(plane[on_plate], points[on_plate, 2], rcond=None)[0]
    outwards, drop = radius - rig.plate_radius, plane @ tilt - points[:, 2]
    # Soft cloth may swing in under the plate.
    hangs = (outwards > 0) | (drop > 2 * _NEAR[1])
    distance, angle = np.hypot(outwards, drop), np.arctan2(drop, outwards)
    turn = np.arctan2(points[:, 1], points[:, 0]) / (2 * np.pi)
    sector = np.floor(_SECTORS * turn).astype(int) % _SECTORS
    outer_half = ((rig.specimen_size - rig.plate_diameter) / 4, np.inf)
    means = np.full((2, _SECTORS), np.nan)
    for row, (low, high) in zip(means, (_NEAR, outer_half), strict=True):
        chosen = hangs & (distance > low) & (distance < high)
        count = np.bincount(sector[chosen], minlength=_SECTORS)
        total = np.bincount(sector[chosen], angle[chosen], minlength=_SECTORS)
        row[count > 0] = total[count > 0] / count[count > 0]
    measured = np.isfinite(means).all(axis=0)
    if measured.sum() < _MIN_SECTORS:
        return np.nan
    near, outer = means[:, measured].mean(axis=1)
    return float(near / outer)


def check_rim(points: Points, path: Path, rig: Rig) -> None:
    """InputError for a surface with a kink at the plate's rim, as no cloth held there has."""
    if (ratio := rim_steepness(points, rig)) > MAX_RIM_STEEPNESS:
        low, high = (1e3 * distance for distance in _NEAR)
        raise InputError(
            f"{path}: {low:g} to {high:g} mm outside the plate's rim the surface is {ratio:.2f} "
            f"times as steep as further out, at most {MAX_RIM_STEEPNESS:g} is possible for cloth "
            "that a plate holds: it has a kink there; give the measured surface, not one computed "
            f"from an outline, and a plate of {1e3 * rig.plate_radius:g} mm radius")
