"""Where the plate of a drape tester lies in frames of a whole scene, by geometry alone.

The table, or a guess at the camera's pitch, says which way is up. Of all level patches the plate is
the one that fills a disc of its radius and has something hanging around it.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from data.render import import_open3d
from sim.scene import Rig

_FARTHEST = 2.5  # m, of what can be table or plate
_SAMPLE = 60_000  # points that the plate is looked for in
_FEWEST = 200  # points
_VOXEL, _OFF_PLANE = 8e-3, 8e-3  # m: grid of the points that planes are looked for in; their noise
_PLANES, _LEAST_PLANE = 4, 0.04  # planes looked for; least share of the points
_PITCHES = np.radians(np.arange(20.0, 60.0, 5.0))  # guesses where no table is seen
_STEEPEST = np.radians(10.0), np.radians(75.0)  # of the camera's pitch above a table
_ROLLED = np.radians(20.0)  # largest roll of a table in the picture
_TABLE_TILT = np.radians(6.0)  # between table and plate
TABLE_GAP = (0.08, 0.7)  # m, of a table below the plate
_CELL = 6e-3  # m, of the grid that a disc is looked for in
_BESIDE = 9e-3, 24e-3  # m beyond the rim, where little should be as high as the plate
_RING = 0.3  # what a full ring costs: stiff cloth is nearly level there
_HANGS = (0.1, 0.25), (0.25, 0.4)  # of the longest overhang: distances from the rim
_SECTORS = 16  # of the half that faces the camera
_PER_METRE = 1.0  # what distance costs, 1/m
_LEAST = 0.7  # of a plate's score; a bare table reaches 0.2, a jar 0.5, a drape 1.0 to 1.5
_ROUNDS = ((8e-3, 0.8), (4e-3, 0.75), (3e-3, 0.75), (3e-3, 0.75))
"""m from the plane and share of the radius within which points count, round by round."""
_LEVEL = 2e-3  # m, below the plate, of the cloth whose middle is the centre
_NEARER = 2.9e-3
"""m, by which that middle lies nearer to the camera than the plate's: of the cloth that bends down
over the rim, more is seen on this side."""


@dataclass(frozen=True)
class Plate:
    """The plate in camera axes.

    Attributes:
        centre: (3,) m, of its top.
        normal: (3,) unit vector, up.
        table: (4,) plane a, b, c, d with a x + b y + c z + d = height above it, m; None where no
            table was seen.
    """

    centre: np.ndarray
    normal: np.ndarray
    table: np.ndarray | None

    @property
    def pose(self) -> np.ndarray:
        """(4, 4) from the plate's axes to the camera's: x along the picture's rows, z up."""
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = _axes(self.normal), self.centre
        return pose

    def local(self, points: np.ndarray) -> np.ndarray:
        """Points (..., 3) of the camera's axes in the plate's, m."""
        return (points - self.centre) @ _axes(self.normal)


def find_plate(points: np.ndarray, rig: Rig) -> Plate | None:
    """The plate under the cloth in points (N, 3), m, camera axes, of all frames; None without one.
    """
    points = points[points[:, 2] < _FARTHEST]
    few = points[:: max(1, len(points) // _SAMPLE)]
    if len(few) < _FEWEST:
        return None
    tables = _level_planes(few)
    best = max((_search(few, plane[:3], rig) for plane in tables), key=_score, default=None)
    if _score(best) < _LEAST:
        guesses = (np.array([0.0, -np.cos(pitch), -np.sin(pitch)]) for pitch in _PITCHES)
        best = max((_search(few, up, rig) for up in guesses), key=_score)
    if _score(best) < _LEAST:
        return None
    _, centre, normal = best
    centre, normal = _refined(points, centre, normal, rig)
    # The largest comes first.
    table = next((plane for plane in tables if plane[:3] @ normal > np.cos(_TABLE_TILT)
                  and TABLE_GAP[0] < plane @ [*centre, 1.0] < TABLE_GAP[1]), None)
    return Plate(centre, normal, table)


def _axes(normal: np.ndarray) -> np.ndarray:
    """Columns: right in the picture, away from the camera, up."""
    east = np.array([1.0, 0.0, 0.0]) - normal[0] * normal
    east /= max(np.linalg.norm(east), 1e-12)
    return np.stack([east, np.cross(normal, east), normal], axis=1)


def _level_planes(points: np.ndarray) -> list[np.ndarray]:
    """Planes (4,), as :attr:`Plate.table`, that a camera above them could have in its picture."""
    open3d = import_open3d()
    open3d.utility.random.seed(0)
    cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points))
    cloud = cloud.voxel_down_sample(_VOXEL)
    total, found = len(cloud.points), []
    for _ in range(_PLANES):
        if len(cloud.points) < max(100, _LEAST_PLANE * total):
            break
        plane, inside = cloud.segment_plane(_OFF_PLANE, ransac_n=3, num_iterations=500)
        cloud = cloud.select_by_index(inside, invert=True)
        if len(inside) < _LEAST_PLANE * total:
            break
        plane = np.asarray(plane) * (1.0 if plane[3] > 0 else -1.0)  # the camera is above it
        pitch = np.arcsin(np.clip(-plane[2], -1.0, 1.0))
        if _STEEPEST[0] < pitch < _STEEPEST[1] and (
                abs(np.arctan2(plane[0], -plane[1])) < _ROLLED):
            found.append(plane)
    return found


def _score(found: tuple[float, np.ndarray, np.ndarray] | None) -> float:
    return found[0] if found else -np.inf


def _search(
    points: np.ndarray, up: np.ndarray, rig: Rig
) -> tuple[float, np.ndarray, np.ndarray] | None:
    """Score, centre (3,) and ``up`` of the patch most like a plate; None where nothing is level."""
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
        here = filled[(filled[:, 2] == level) | (filled[:, 2] == level + 1)]
        grid = np.zeros(shape, np.float32)
        grid[here[:, 1], here[:, 0]] = 1.0
        grid = cv2.morphologyEx(grid, cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8))
        fit = cv2.filter2D(grid, -1, inside, borderType=cv2.BORDER_CONSTANT)
        fit -= _RING * cv2.filter2D(grid, -1, around, borderType=cv2.BORDER_CONSTANT)
        row, column = np.unravel_index(fit.argmax(), fit.shape)
        middle = low + _CELL * np.array([column + 0.5, row + 0.5, level + 1.0])
        # Nothing stands before the cloth: of equals the nearer one.
        score = float(fit[row, column]) + _hanging(local - middle, rig) - _PER_METRE * (
            np.linalg.norm(middle))
        if best is None or score > best[0]:
            best = score, axes @ middle, up
    return best


def _kernels(radius: float) -> tuple[np.ndarray, np.ndarray]:
    """A disc and a ring around it, on the grid, each with a sum of 1."""
    size = int(np.ceil((radius + _BESIDE[1]) / _CELL))
    away = _CELL * np.hypot(*np.mgrid[-size : size + 1, -size : size + 1])
    disc = (away <= radius).astype(np.float32)
    ring = ((away > radius + _BESIDE[0]) & (away < radius + _BESIDE[1])).astype(np.float32)
    return disc / disc.sum(), ring / ring.sum()


def _hanging(local: np.ndarray, rig: Rig) -> float:
    """Share of the directions towards the camera in which cloth seems to hang from a plate's rim.

    ``local`` (N, 3), m, of the would-be plate's axes.
    """
    beyond, longest = np.hypot(local[:, 0], local[:, 1]) - rig.plate_radius, rig.overhang
    away = np.hypot(beyond, local[:, 2])
    hanging = (beyond > 0) & (local[:, 2] < 0) & (local[:, 1] < 0)
    seen = np.ones(_SECTORS, bool)
    for near, far in _HANGS:  # without a gap from the rim on
        ring = local[hanging & (away > near * longest) & (away < far * longest)]
        sector = (np.arctan2(-ring[:, 1], ring[:, 0]) / np.pi * _SECTORS).astype(int)
        seen &= np.bincount(sector, minlength=_SECTORS)[:_SECTORS] > 0
    return float(seen.mean())


def _refined(
    points: np.ndarray, centre: np.ndarray, normal: np.ndarray, rig: Rig
) -> tuple[np.ndarray, np.ndarray]:
    """Centre (3,) and normal (3,) from all points on the plate."""
    points = points[np.linalg.norm(points - centre, axis=1) < 2 * rig.plate_radius]
    for off, share in _ROUNDS:
        away = points - centre
        above = away @ normal
        across = np.linalg.norm(away - above[:, None] * normal, axis=1)
        inner = (np.abs(above) < off) & (across < share * rig.plate_radius)
        if inner.sum() < 10:
            break
        middle = points[inner].mean(axis=0)
        normal = np.linalg.eigh(np.cov((points[inner] - middle).T))[1][:, 0]
        normal = normal * -np.sign(normal @ middle)  # up is towards the camera
        above = (points - middle) @ normal
        level = np.abs(above) < _LEVEL
        level &= np.linalg.norm(points - centre, axis=1) < 1.5 * rig.plate_radius
        # Pixels are denser where the plate is nearer; z³ undoes that on a plane.
        weights = points[level, 2] ** 3
        centre = weights @ points[level] / weights.sum()
        centre = centre - ((centre - middle) @ normal) * normal
    return centre + _NEARER * _axes(normal)[:, 1], normal
