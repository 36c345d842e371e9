"""Meshes of scanned drapes on the disc rig, and a check of their shape at the plate's rim."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from common.documents import read_arrays
from common.errors import InputError
from common.types import Faces, Points, RestPoints
from sim.mesh import Mesh
from sim.rig import Rig

MAX_SCAN_SIZE = 1_000_000  # vertices or triangles
MAX_RIM_STEEPNESS = 0.85
"""Of :func:`rim_steepness`: at most 0.76 in scans of 216 simulated drapes with all nuisances, 0.94
or more for straight lines from rim to hem."""
_NEAR = (1e-3, 5e-3)  # m, from the rim
_SECTORS, _MIN_SECTORS = 36, 12  # of azimuth, all and at least measured
_PLANE_TOLERANCE = 5e-3  # m, of cloth on the support
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
        "an npz file of a scan with vertices, rest and faces"))
    positions, rest, faces = arrays["vertices"], arrays["rest"], arrays["faces"]
    if fault := (_array_fault(positions, rest, faces) or _mesh_fault(rest, faces)
                 or _placement_fault(positions, rest, faces, rig)):
        raise InputError(fault, source=path)
    return Scan(positions.astype(np.float64), rest.astype(np.float64), faces.astype(np.int64))


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
            f"{low:g} to {high:g} mm outside the plate's rim the surface is {ratio:.2f} "
            f"times as steep as further out, at most {MAX_RIM_STEEPNESS:g} is possible for cloth "
            "that a plate holds: it has a kink there; give the measured surface, not one computed "
            f"from an outline, and a plate of {1e3 * rig.plate_radius:g} mm radius", source=path)
