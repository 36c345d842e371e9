"""The place of the plate of a drape tester in camera axes, under cloth.

In views that show only cloth, the plate is the flat top. In frames of a full scene it is the level
patch that fills a disc of its radius and has cloth hanging around it; the vertical is the normal of
the table or, if none is visible, that of a trial pitch of the camera.
"""

from dataclasses import dataclass
from operator import itemgetter

import cv2
import numpy as np

from common.types import Metres, Points, Pose, Vector, VertexMask, Views
from data.captures.plane_fit import alternated, largest_plane
from data.render.cameras import Intrinsics
from sim.rig import Rig

DEPTH_STEP = 4e-3  # m, of the coarsest depth format
INNER_SHARE = 0.7  # of the plate's radius, within which the cloth is flat
CENTRE_BIAS = 2.0e-3
"""m, bias of a fitted centre towards the camera: cloth bends down over the rim, and more of it is
visible on the camera's side."""
_START_POINTS = 6000  # used to find the initial plane of cut-out cloth
_START_PITCHES = np.radians([25.0, 32.0, 38.0, 44.0, 50.0])
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
_HEIGHT_ERROR = 8e-3  # m, of the plate of a search


@dataclass(frozen=True)
class Plate:
    """A plate, fitted to the cloth on it, in camera axes.

    Attributes:
        centre: of the level cloth; :data:`CENTRE_BIAS` from the plate's axis.
        normal: unit vector, up.
        table: (4,) plane a, b, c, d with a x + b y + c z + d = height above it, m.
    """

    centre: Vector
    normal: Vector
    table: np.ndarray | None = None

    @property
    def pose(self) -> Pose:
        """From the axes of the fitted centre: x along the picture's rows, z up."""
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = _axes(self.normal), self.centre
        return pose

    @property
    def axis_centre(self) -> Vector:
        """Centre without bias."""
        return self.centre + CENTRE_BIAS * _axes(self.normal)[:, 1]

    def local(self, points: np.ndarray) -> np.ndarray:
        """Points (..., 3), m, in the axes of the plate."""
        return (points - self.axis_centre) @ _axes(self.normal)


def plate_of_cloth(views: Views, intrinsics: Intrinsics, rig: Rig) -> Plate:
    """The plate under cut-out cloth: the plane that holds the largest area of the highest points
    of all views, whose centre is unbiased along the picture's rows.
    """
    points = np.concatenate([intrinsics.points(view) for view in views])
    few = points[:: max(1, len(points) // _START_POINTS)]
    starts = [_fitted(few, up, _highest(few, up), rig.plate_radius, rounds=4)
              for up in _upwards(_START_PITCHES)]
    normal = max(starts, key=lambda start: start[2])[0]
    normal, centre, _ = _fitted(few, normal, _highest(few, normal), rig.plate_radius, rounds=6)
    top = _highest(points, normal) & (
        np.linalg.norm(points - centre, axis=1) < INNER_SHARE * rig.plate_radius)
    normal, centre, _ = _fitted(points, normal, top, rig.plate_radius, rounds=2, centre=centre)
    return Plate(centre, normal)


def _highest(points: Points, normal: Vector) -> VertexMask:
    height = points @ normal
    return height > np.quantile(height, 0.995) - 3 * DEPTH_STEP


def _fitted(
    points: Points, normal: Vector, inner: VertexMask, radius: Metres, *, rounds: int,
    centre: Vector | None = None,
) -> tuple[Vector, Vector, float]:
    """Normal and centre of the level points, and their weight, by alternating fits from guesses.

    The plane is fitted to points ``inner`` well within the rim, the centre is the centroid of those
    in it.
    """
    centre = points[inner].mean(axis=0) if centre is None else centre
    return alternated(points, normal, inner.copy(), radius, rounds, centre, DEPTH_STEP,
                      INNER_SHARE * radius)


def find_plate(points: Points, rig: Rig) -> Plate | None:
    """Find the plate under the cloth in points of all frames of a scene; None if there is none."""
    points = points[points[:, 2] < _MAX_DEPTH]
    sample = points[:: max(1, len(points) // _MAX_POINTS)]
    if len(sample) < _MIN_POINTS:
        return None
    tables = _level_planes(sample)
    candidates = [_search(sample, plane[:3], rig) for plane in tables]
    if max(map(itemgetter(0), candidates), default=0.0) < _MIN_SCORE:
        candidates = [_search(sample, up, rig) for up in _upwards(_PITCHES)]
    score, centre, normal = max(candidates, key=itemgetter(0))
    if score < _MIN_SCORE:
        return None
    centre, normal = _refined(points, centre, normal, rig.plate_radius)
    table = next((plane for plane in tables if plane[:3] @ normal > np.cos(_MAX_TABLE_TILT)
                  and TABLE_GAP[0] < plane @ [*centre, 1.0] < TABLE_GAP[1]), None)
    return Plate(centre, normal, table)


def _upwards(pitches: np.ndarray) -> list[Vector]:
    """Vertical directions in camera axes, for pitches (N,), rad, of the camera."""
    return [np.array([0.0, -np.cos(pitch), -np.sin(pitch)]) for pitch in pitches]


def _axes(normal: Vector) -> np.ndarray:
    """Axes of the plate as columns (3, 3): right in the picture, away from the camera, up."""
    right = np.array([1.0, 0.0, 0.0]) - normal[0] * normal
    right /= max(np.linalg.norm(right), 1e-12)
    return np.stack([right, np.cross(normal, right), normal], axis=1)


def _level_planes(points: Points) -> list[np.ndarray]:
    """Planes, as :attr:`Plate.table`, that are horizontal for a plausible pose; largest first."""
    rng, planes = np.random.default_rng(0), []
    _, kept = np.unique(np.floor(points / _VOXEL).astype(int), axis=0, return_index=True)
    cloud = points[np.sort(kept)]
    total = len(cloud)
    for _ in range(_MAX_PLANES):
        if len(cloud) < max(100, _MIN_PLANE_SHARE * total):
            break
        normal, shift = largest_plane(cloud, _PLANE_TOLERANCE, draws=500, rng=rng)
        inside = np.abs(cloud @ normal + shift) < _PLANE_TOLERANCE
        cloud = cloud[~inside]
        if inside.sum() < _MIN_PLANE_SHARE * total:
            break
        plane = np.array([*normal, shift]) * (1.0 if shift > 0 else -1.0)  # the camera is above it
        pitch = np.arcsin(np.clip(-plane[2], -1.0, 1.0))
        if _PITCH_RANGE[0] < pitch < _PITCH_RANGE[1] and (
                abs(np.arctan2(plane[0], -plane[1])) < _MAX_ROLL):
            planes.append(plane)
    return planes


def _search(points: Points, up: Vector, rig: Rig) -> tuple[float, Vector, Vector]:
    """Score, centre and ``up`` of the best candidate for the plate; minus infinity without one."""
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
    best = -np.inf, low, up
    for level in levels:
        patch = filled[(filled[:, 2] == level) | (filled[:, 2] == level + 1)]
        grid = np.zeros(shape, np.float32)
        grid[patch[:, 1], patch[:, 0]] = 1.0
        grid = cv2.morphologyEx(grid, cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8))
        fit = cv2.filter2D(grid, -1, inside, borderType=cv2.BORDER_CONSTANT)
        fit = fit - _RING_PENALTY * cv2.filter2D(grid, -1, around, borderType=cv2.BORDER_CONSTANT)
        row, column = np.unravel_index(fit.argmax(), fit.shape)
        middle = low + _CELL * np.array([column + 0.5, row + 0.5, level + 1.0])
        # Nothing is between the camera and the cloth: of equal candidates, the nearer one.
        score = float(fit[row, column]) + _hanging(local - middle, rig) - _DISTANCE_PENALTY * (
            float(np.linalg.norm(middle)))
        if score > best[0]:
            best = score, axes @ middle, up
    return best


def _kernels(radius: Metres) -> tuple[np.ndarray, np.ndarray]:
    """Filter kernels of a disc and of a ring around it on the grid, each with a sum of 1."""
    size = int(np.ceil((radius + _RING_WIDTH[1]) / _CELL))
    distance = _CELL * np.hypot(*np.mgrid[-size : size + 1, -size : size + 1])
    disc = (distance <= radius).astype(np.float32)
    ring = ((distance > radius + _RING_WIDTH[0])
            & (distance < radius + _RING_WIDTH[1])).astype(np.float32)
    return disc / disc.sum(), ring / ring.sum()


def _hanging(local: Points, rig: Rig) -> float:
    """Share of the sectors towards the camera in which points hang from a candidate's rim."""
    beyond, longest = np.hypot(local[:, 0], local[:, 1]) - rig.plate_radius, rig.overhang
    distance = np.hypot(beyond, local[:, 2])
    hanging = (beyond > 0) & (local[:, 2] < 0) & (local[:, 1] < 0)
    filled = np.ones(_SECTORS, bool)
    for near, far in _HEM_RINGS:  # both must have points: cloth has no gap from the rim on
        ring = local[hanging & (distance > near * longest) & (distance < far * longest)]
        sector = (np.arctan2(-ring[:, 1], ring[:, 0]) / np.pi * _SECTORS).astype(int)
        filled &= np.bincount(sector, minlength=_SECTORS)[:_SECTORS] > 0
    return float(filled.mean())


def _refined(
    points: Points, centre: Vector, normal: Vector, radius: Metres
) -> tuple[Vector, Vector]:
    """Centre and normal of a plate, from rough ones."""
    offset = points - centre
    across, above = np.linalg.norm(offset, axis=1), offset @ normal
    near = (across < 2 * radius) & (above < _HEIGHT_ERROR)
    points, across, above = points[near], across[near], above[near]
    inner = (across < INNER_SHARE * radius) & (np.abs(above) < _HEIGHT_ERROR)
    if not inner.any():
        return centre, normal
    normal, centre, _ = _fitted(points, normal, inner, radius, rounds=4, centre=centre)
    return centre, normal
