"""The largest plane among points: random sample consensus (Fischler and Bolles 1981)."""

import numpy as np

from common.errors import InputError
from common.types import Metres, Points, Vector

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
