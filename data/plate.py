"""Geometric detection of a drape tester's plate in frames of a full scene.

The vertical is the normal of the table or, if no table is visible, a trial pitch of the camera. The
plate is the horizontal patch that fills a disc of its radius and has cloth hanging around it.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from data.render import import_open3d
from sim.scene import Rig

_MAX_DEPTH = 2.5  # m, of table and plate
_MAX_POINTS = 60_000  # of the subsample in which the plate is searched
_MIN_POINTS = 200
_VOXEL, _PLANE_TOLERANCE = 8e-3, 8e-3  # m: grid of the points to which planes are fitted; noise
_MAX_PLANES, _MIN_PLANE_SHARE = 4, 0.04  # planes that are fitted; share of the points
_PITCHES = np.radians(np.arange(20.0, 60.0, 5.0))  # trial values if no table is visible
_PITCH_RANGE = np.radians(10.0), np.radians(75.0)  # of the camera above a table
_MAX_ROLL = np.radians(20.0)  # of a table in the picture
_MAX_TABLE_TILT = np.radians(6.0)  # between table and plate
TABLE_GAP = (0.08, 0.7)  # m, from the table to the plate
_CELL = 6e-3  # m, of the grid in which a disc is searched
_RING_WIDTH = 9e-3, 24e-3  # m beyond the rim, where few points should be as high as the plate
_RING_PENALTY = 0.3  # of a full ring; small, because stiff cloth is nearly level there
_HEM_RINGS = (0.1, 0.25), (0.25, 0.4)  # distances from the rim, relative to the longest overhang
_SECTORS = 16  # of the half that faces the camera
_DISTANCE_PENALTY = 1.0  # 1/m
_MIN_SCORE = 0.7  # of a plate; a bare table reaches 0.2, a jar 0.5, a drape 1.0 to 1.5
_REFINEMENTS = ((8e-3, 0.8), (4e-3, 0.75), (3e-3, 0.75), (3e-3, 0.75))
"""Distance from the plane, m, and share of the radius within which points are fitted, by iteration.
"""
_LEVEL_TOLERANCE = 2e-3  # m from the plane, of the points whose centroid is the centre
_CENTRE_OFFSET = 2.9e-3
"""m, bias of this centroid towards the camera: more of the cloth that bends over the rim is visible
on the near side."""


@dataclass(frozen=True)
class Plate:
    """The plate in camera axes.

    Attributes:
        centre: (3,) m, of its top.
        normal: (3,) unit vector, up.
        table: (4,) plane a, b, c, d with a x + b y + c z + d = height above it, m; None if no table
            was found.
    """

    centre: np.ndarray
    normal: np.ndarray
    table: np.ndarray | None

    @property
    def pose(self) -> np.ndarray:
        """(4, 4) transform to the camera's axes from the plate's: x along the picture's rows, z up.
        """
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = _axes(self.normal), self.centre
        return pose

    def local(self, points: np.ndarray) -> np.ndarray:
        """Transform points (..., 3), m, from camera axes to the plate's axes."""
        return (points - self.centre) @ _axes(self.normal)


def find_plate(points: np.ndarray, rig: Rig) -> Plate | None:
    """Find the plate under the cloth in points (N, 3) of all frames, m, camera axes; None if there
    is none.
    """
    points = points[points[:, 2] < _MAX_DEPTH]
    sample = points[:: max(1, len(points) // _MAX_POINTS)]
    if len(sample) < _MIN_POINTS:
        return None
    tables = _level_planes(sample)
    best = max((_search(sample, plane[:3], rig) for plane in tables), key=_score, default=None)
    if _score(best) < _MIN_SCORE:
        trials = (np.array([0.0, -np.cos(pitch), -np.sin(pitch)]) for pitch in _PITCHES)
        best = max((_search(sample, up, rig) for up in trials), key=_score)
    if _score(best) < _MIN_SCORE:
        return None
    _, centre, normal = best
    centre, normal = _refined(points, centre, normal, rig)
    # Planes are sorted by size.
    table = next((plane for plane in tables if plane[:3] @ normal > np.cos(_MAX_TABLE_TILT)
                  and TABLE_GAP[0] < plane @ [*centre, 1.0] < TABLE_GAP[1]), None)
    return Plate(centre, normal, table)


def _axes(normal: np.ndarray) -> np.ndarray:
    """Axes of the plate as columns (3, 3): right in the picture, away from the camera, up."""
    right = np.array([1.0, 0.0, 0.0]) - normal[0] * normal
    right /= max(np.linalg.norm(right), 1e-12)
    return np.stack([right, np.cross(normal, right), normal], axis=1)


def _level_planes(points: np.ndarray) -> list[np.ndarray]:
    """Planes (4,), as :attr:`Plate.table`, that are horizontal for a plausible camera pose."""
    open3d = import_open3d()
    open3d.utility.random.seed(0)
    cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points))
    cloud = cloud.voxel_down_sample(_VOXEL)
    total, found = len(cloud.points), []
    for _ in range(_MAX_PLANES):
        if len(cloud.points) < max(100, _MIN_PLANE_SHARE * total):
            break
        plane, inside = cloud.segment_plane(_PLANE_TOLERANCE, ransac_n=3, num_iterations=500)
        cloud = cloud.select_by_index(inside, invert=True)
        if len(inside) < _MIN_PLANE_SHARE * total:
            break
        plane = np.asarray(plane) * (1.0 if plane[3] > 0 else -1.0)  # the camera is above it
        pitch = np.arcsin(np.clip(-plane[2], -1.0, 1.0))
        if _PITCH_RANGE[0] < pitch < _PITCH_RANGE[1] and (
                abs(np.arctan2(plane[0], -plane[1])) < _MAX_ROLL):
            found.append(plane)
    return found


def _score(found: tuple[float, np.ndarray, np.ndarray] | None) -> float:
    return found[0] if found else -np.inf


def _search(
    points: np.ndarray, up: np.ndarray, rig: Rig
) -> tuple[float, np.ndarray, np.ndarray] | None:
    """Score, centre (3,) and ``up`` of the best candidate for the plate; None without candidates.
    """
    axes = _axes(up)
    local = points @ axes
    low = local.min(axis=0)
    cells = np.floor((local - low) / _CELL).astype(int)
    filled = np.unique(cells, axis=0)
    counts = np.bincount(filled[:, 2])
    area = np.pi * (rig.plate_radius / _CELL) ** 2
    levels = np.flatnonzero(counts + np.append(counts[1:], 0) > area / 3)
    inside, around = _kernels(rig.plate_radius)
    shape = filled[:, 1::-1].max(axis=0) + 1
    best = None
    for level in levels:
        patch = filled[(filled[:, 2] == level) | (filled[:, 2] == level + 1)]
        grid = np.zeros(shape, np.float32)
        grid[patch[:, 1], patch[:, 0]] = 1.0
        grid = cv2.morphologyEx(grid, cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8))
        fit = cv2.filter2D(grid, -1, inside, borderType=cv2.BORDER_CONSTANT)
        fit -= _RING_PENALTY * cv2.filter2D(grid, -1, around, borderType=cv2.BORDER_CONSTANT)
        row, column = np.unravel_index(fit.argmax(), fit.shape)
        middle = low + _CELL * np.array([column + 0.5, row + 0.5, level + 1.0])
        # Nothing is between the camera and the cloth: of equal candidates, the nearer one.
        score = float(fit[row, column]) + _hanging(local - middle, rig) - _DISTANCE_PENALTY * (
            np.linalg.norm(middle))
        if best is None or score > best[0]:
            best = score, axes @ middle, up
    return best


def _kernels(radius: float) -> tuple[np.ndarray, np.ndarray]:
    """Filter kernels of a disc and of a ring around it on the grid, each with a sum of 1."""
    size = int(np.ceil((radius + _RING_WIDTH[1]) / _CELL))
    distance = _CELL * np.hypot(*np.mgrid[-size : size + 1, -size : size + 1])
    disc = (distance <= radius).astype(np.float32)
    ring = ((distance > radius + _RING_WIDTH[0])
            & (distance < radius + _RING_WIDTH[1])).astype(np.float32)
    return disc / disc.sum(), ring / ring.sum()


def _hanging(local: np.ndarray, rig: Rig) -> float:
    """Share of the sectors towards the camera in which points hang from the rim of a candidate.

    ``local`` (N, 3), m, in the candidate's axes.
    """
    beyond, longest = np.hypot(local[:, 0], local[:, 1]) - rig.plate_radius, rig.overhang
    distance = np.hypot(beyond, local[:, 2])
    hanging = (beyond > 0) & (local[:, 2] < 0) & (local[:, 1] < 0)
    seen = np.ones(_SECTORS, bool)
    for near, far in _HEM_RINGS:  # both must have points: cloth has no gap from the rim on
        ring = local[hanging & (distance > near * longest) & (distance < far * longest)]
        sector = (np.arctan2(-ring[:, 1], ring[:, 0]) / np.pi * _SECTORS).astype(int)
        seen &= np.bincount(sector, minlength=_SECTORS)[:_SECTORS] > 0
    return float(seen.mean())


def _refined(
    points: np.ndarray, centre: np.ndarray, normal: np.ndarray, rig: Rig
) -> tuple[np.ndarray, np.ndarray]:
    """Refine centre (3,) and normal (3,) iteratively with all points on the plate."""
    points = points[np.linalg.norm(points - centre, axis=1) < 2 * rig.plate_radius]
    for off, share in _REFINEMENTS:
        offset = points - centre
        above = offset @ normal
        across = np.linalg.norm(offset - above[:, None] * normal, axis=1)
        inner = (np.abs(above) < off) & (across < share * rig.plate_radius)
        if inner.sum() < 10:
            break
        middle = points[inner].mean(axis=0)
        normal = np.linalg.eigh(np.cov((points[inner] - middle).T))[1][:, 0]
        normal = normal * -np.sign(normal @ middle)  # up is towards the camera
        above = (points - middle) @ normal
        level = np.abs(above) < _LEVEL_TOLERANCE
        level &= np.linalg.norm(points - centre, axis=1) < 1.5 * rig.plate_radius
        # Pixels are denser where the plate is nearer; z³ compensates for this on a plane.
        weights = points[level, 2] ** 3
        centre = weights @ points[level] / weights.sum()
        centre = centre - ((centre - middle) @ normal) * normal
    return centre + _CENTRE_OFFSET * _axes(normal)[:, 1], normal
