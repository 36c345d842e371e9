"""Planes of points: the largest, by random sample consensus (Fischler and Bolles 1981), and
alternating fits of a plate's plane and centre."""

import numpy as np
from scipy.linalg import eigh

from common.errors import InputError
from common.types import Metres, Points, Vector, VertexMask

_FEW, _BEST = 1000, 25  # points that all draws are tried on, and draws that are tried on all
_REFITS = 2


def largest_plane(
    points: Points, tolerance: Metres, *, draws: int, rng: np.random.Generator
) -> tuple[Vector, float]:
    """Unit normal n and shift d, m, of the plane n·x + d = 0 with the most of the points within a
    ``tolerance``, of ``draws`` planes through three of them, fitted to these points; InputError if
    they lie on a line."""
    corners = points[rng.integers(len(points), size=(draws, 3))]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normals, axis=1)
    corners, normals = corners[length > 0], normals[length > 0] / length[length > 0, None]
    if not len(normals):
        raise InputError("its points are the same or lie on a line; give a surface")
    shifts = -(normals * corners[:, 0]).sum(axis=1)
    few = points[rng.integers(len(points), size=min(_FEW, len(points)))]
    for some in (few, points):
        near = (np.abs(some @ normals.T + shifts) < tolerance).sum(axis=0)
        best = np.argsort(-near, kind="stable")[:_BEST]
        normals, shifts = normals[best], shifts[best]
    normal, shift = normals[0], float(shifts[0])
    for _ in range(_REFITS):
        inside = points[np.abs(points @ normal + shift) < tolerance]
        middle = inside.mean(axis=0)
        normal = np.linalg.eigh((inside - middle).T @ (inside - middle))[1][:, 0]
        shift = -float(normal @ middle)
    return normal, shift


def alternated(
    points: Points, normal: Vector, inner: VertexMask, radius: Metres, rounds: int, centre: Vector,
    thick: Metres, inner_radius: Metres,
) -> tuple[Vector, Vector, float]:
    """Normal, centre and weight of the level points; planes are ``thick``, m."""
    weight, axes = 0.0, np.ascontiguousarray(points.T)
    for _ in range(rounds):
        count = np.count_nonzero(inner)
        if count < 3:
            break  # too few points for a plane: not a drape on a plate
        chosen = axes[:, inner]
        middle = np.array([_sum(axis) for axis in chosen]) / count
        chosen -= middle[:, None]
        spread = np.array([[_sum(one * other) for one in chosen] for other in chosen])
        normal = eigh(spread, driver="evd", check_finite=False)[1][:, 0]
        normal *= -np.sign(normal @ middle)  # up is towards the camera
        above = sum((axes - middle[:, None]) * normal[:, None])
        level = (np.abs(above) < thick / 2) & (_squares(axes, centre) < (2 * radius) ** 2)
        if not level.any():
            break
        # Pixels are denser where the plate is nearer; on a plane, z³ compensates for that.
        cubes = axes[2, level] * axes[2, level] * axes[2, level]
        weight = _sum(cubes)
        centre = np.array([_sum(cubes * axis) for axis in axes[:, level]]) / weight
        # Near the rim the cloth bends down, and more of it is visible in front: a bias.
        inner = (_squares(axes, centre) < inner_radius**2) & (above > -thick)
    return normal, centre, weight


def _squares(axes: np.ndarray, centre: Vector) -> np.ndarray:
    """Squared distances (N,) of points, their coordinates (3, N), from a centre."""
    return sum((axes - centre[:, None]) ** 2)


def _sum(values: np.ndarray) -> float:
    """The sum of values, one added after the other: the same on all processors."""
    return float(np.cumsum(values)[-1])
