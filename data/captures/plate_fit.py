"""Alternating fits of a plate's plane and centre to points."""

import numpy as np
from scipy.linalg import eigh

from common.types import Metres, Points, Vector, VertexMask


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
