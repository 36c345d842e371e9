"""Planes of points: the largest, by random sample consensus (Fischler and Bolles 1981), and
alternating fits of a plate's plane and centre, compiled."""

import numba
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


@numba.njit(cache=True)
def alternated(points, normal, inner, radius, rounds, centre, thick, inner_radius):
    """Normal, centre and weight of the level points; planes are ``thick``, m."""
    weight = 0.0
    for _ in range(rounds):
        count, middle, spread = _moments(points, inner)
        if count < 3:
            break  # too few points for a plane: not a drape on a plate
        normal = np.ascontiguousarray(np.linalg.eigh(spread)[1][:, 0])
        normal *= -np.sign(normal @ middle)  # up is towards the camera
        total, level = _level(points, middle, normal, centre, radius, thick)
        if total == 0.0:
            break
        weight, centre = total, level
        _choose_inner(points, middle, normal, centre, inner_radius, thick, inner)
    return normal, centre, weight


@numba.njit(cache=True)
def _moments(points, chosen):
    """Number of the chosen points, their mean (3,) and their second moments (3, 3) about it."""
    count, middle, spread = 0, np.zeros(3), np.zeros((3, 3))
    for t in range(len(points)):
        if chosen[t]:
            count += 1
            for k in range(3):
                middle[k] += points[t, k]
    middle /= max(count, 1)
    for t in range(len(points)):
        if chosen[t]:
            for i in range(3):
                for k in range(i + 1):
                    spread[i, k] += (points[t, i] - middle[i]) * (points[t, k] - middle[k])
    return count, middle, spread  # the lower triangle, which eigh reads


@numba.njit(cache=True)
def _level(points, middle, normal, centre, radius, thick):
    """Weight and weighted centroid (3,) of the points in a plane, near a centre.

    Pixels are denser where the plate is nearer; on a plane, z³ compensates for that.
    """
    total, sums = 0.0, np.zeros(3)
    for t in range(len(points)):
        above = aside = 0.0
        for k in range(3):
            above += (points[t, k] - middle[k]) * normal[k]
            aside += (points[t, k] - centre[k]) ** 2
        if abs(above) < thick / 2 and aside < (2 * radius) ** 2:
            weight = points[t, 2] ** 3
            total += weight
            for k in range(3):
                sums[k] += weight * points[t, k]
    return total, sums / max(total, 1e-300)


@numba.njit(cache=True)
def _choose_inner(points, middle, normal, centre, inner_radius, thick, inner):
    """Mark the points well within the rim that are not below a plane.

    Near the rim the cloth bends down, and more of it is visible in front: a bias.
    """
    for t in range(len(points)):
        above = aside = 0.0
        for k in range(3):
            above += (points[t, k] - middle[k]) * normal[k]
            aside += (points[t, k] - centre[k]) ** 2
        inner[t] = aside < inner_radius**2 and above > -thick
