"""Measures of a drape: drape coefficient, folds, stretch, penetration of obstacles."""

from collections.abc import Callable

import numba
import numpy as np
from scipy.interpolate import LinearNDInterpolator

from common.arguments import numbers, require
from common.errors import InputError
from common.types import Faces, Metres, Outline, Points, RestPoints, VertexMask
from common.workers import one_blas_thread
from sim.energies.membrane import Corotational
from sim.mesh import Mesh
from sim.outlines import coefficient_of_area, folds_around
from sim.rig import Cylinder, Rig

_PIXEL = 5e-4  # m, of the rasterised top view
_OUTLINE_POINTS = 720


def drape_coefficient(positions: Points, faces: Faces, rig: Rig) -> float:
    """(projected area - plate area) / (specimen area - plate area) (BS 5058, ISO 9073-9), accurate
    to 0.3 %; 1 for a rigid specimen, 0 for one that hangs straight down. InputError for positions
    that cannot be those of cloth on ``rig``."""
    positions, faces = _placed(positions, rig), np.asarray(faces)
    if not (faces.dtype.kind in "iu" and faces.ndim == 2 and faces.shape[1] == 3
            and faces.max(initial=0) < len(positions)):
        raise InputError(f"faces of the shape {faces.shape}: give indices (F, 3) of "
                         f"{len(positions)} positions")
    return coefficient_of_area(projected_area(positions, faces), rig)


def _placed(positions: Points, rig: Rig) -> Points:
    """Positions of cloth on ``rig``, which covers the plate."""
    require(rig=(rig, Rig))
    positions = numbers("positions", positions, "finite positions (V, 3), m", (None, 3))
    _require_extent("positions", positions[:, :2], rig, np.sqrt(2) * 0.9 * rig.plate_diameter)
    return positions


def _require_extent(name: str, points: np.ndarray, rig: Rig, least: Metres) -> None:
    """InputError for points (V, 2) from above that no specimen of ``rig`` has: the box around them
    has a diagonal below ``least`` or above that around a disc."""
    diagonal = np.hypot(*np.ptp(points, axis=0))
    if not least <= diagonal <= 2.9 * rig.reach:
        raise InputError(f"{name} extend over {diagonal:.4g} m, from {least:.3g} to "
                         f"{2.9 * rig.reach:.3g} m with {rig.name}: give metres, and the rig of "
                         "this drape")


def projected_area(positions: Points, faces: Faces) -> float:
    """Area of the vertical projection, m²."""
    corner = positions[:, :2].min(0) - _PIXEL
    pixels = (positions[:, :2] - corner) / _PIXEL
    shape = np.ceil(pixels.max(0)).astype(int) + 2
    return _covered(pixels[faces], shape[0], shape[1]) * _PIXEL**2


@one_blas_thread
def fold_outline(positions: Points, rest: RestPoints, rig: Rig) -> Outline:
    """The material circle of 90 % of the specimen's inradius, around its centre, seen from above:
    720 points half a degree apart, from the warp axis towards the weft. InputError for points that
    cannot be those of the specimen of ``rig``."""
    positions = _placed(positions, rig)
    rest = numbers("rest", rest, "finite rest points (V, 2) of the positions, m",
                   (len(positions), 2))
    _require_extent("rest", rest, rig, 1.8 * rig.reach)
    angle = np.linspace(0, 2 * np.pi, _OUTLINE_POINTS, endpoint=False)
    circle = 0.45 * min(rig.sides) * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    centre = (rest.min(axis=0) + rest.max(axis=0)) / 2
    return LinearNDInterpolator(rest, positions[:, :2])(centre + circle)


def fold_angles(outline: Outline) -> np.ndarray:
    """Angles (n,) of the folds on the material circle, radians, ascending. A fold is a peak of the
    distance from the axis along ``outline`` (:func:`fold_outline`), at least 3 mm high."""
    return folds_around(np.linalg.norm(outline, axis=1), 6.0) * (2 * np.pi / len(outline))


def fold_count(positions: Points, rest: RestPoints, rig: Rig) -> int:
    """Number of folds; see :func:`fold_angles`."""
    return len(fold_angles(fold_outline(positions, rest, rig)))


def maximum_stretch(positions: Points, rest: RestPoints, faces: Faces, held: VertexMask) -> float:
    """Largest strain in any triangle that is not held, 0.01 for 1 %."""
    mesh = Mesh(rest=rest, faces=faces)
    membrane = Corotational().energy(mesh, ~held[faces].all(axis=1))
    return float(membrane.stretches(positions.ravel()).max() - 1.0)


def max_penetration(positions: Points, faces: Faces, rig: Rig) -> Metres:
    """Largest penetration of cloth into the rig's obstacles, also between vertices. Exact to a
    micrometre; 0 without penetration."""
    corners = positions[faces]
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    deepest = 0.0
    for obstacle in rig.obstacles:
        at_corners = obstacle.depths(positions)[faces].max(axis=1)
        near = corners[at_corners > -longest]  # depth changes by at most the distance
        if len(near):
            deepest = max(deepest, float(_largest_depths(obstacle, near).max()))
    return deepest


def _largest_depths(obstacle: Cylinder, triangles: np.ndarray) -> np.ndarray:
    """(N,) largest depths on triangles (N, 3, 3), m, by two nested searches: depth is concave, with
    one maximum along any line, which is concave in the line's position across the triangle."""
    a, b, c = triangles.transpose(1, 0, 2)

    def along_line(share: np.ndarray) -> np.ndarray:
        start, end = a + share[:, None] * (b - a), a + share[:, None] * (c - a)
        return _largest(lambda t: obstacle.depths(start + t[:, None] * (end - start)),
                        len(triangles))

    return _largest(along_line, len(triangles))


def _largest(function: Callable[[np.ndarray], np.ndarray], count: int) -> np.ndarray:
    """(N,) maxima over [0, 1] of ``count`` concave functions, by golden section."""
    golden = (np.sqrt(5) - 1) / 2
    low, high = np.zeros(count), np.ones(count)
    left, right = high - golden * (high - low), low + golden * (high - low)
    at_left, at_right = function(left), function(right)
    best = np.maximum(function(low), function(high))
    for _ in range(20):
        best = np.maximum(best, np.maximum(at_left, at_right))
        up = at_left < at_right
        low, high = np.where(up, left, low), np.where(up, high, right)
        new = np.where(up, low + golden * (high - low), high - golden * (high - low))
        at_new = function(new)
        left, right = np.where(up, right, new), np.where(up, new, left)
        at_left, at_right = np.where(up, at_right, at_new), np.where(up, at_new, at_left)
    return np.maximum(best, np.maximum(at_left, at_right))


@numba.njit(cache=True)
def _covered(triangles, width, height):
    """Number of unit pixels whose centre lies in a triangle (N, 3, 2) of either orientation."""
    seen = np.zeros((width, height), dtype=np.bool_)
    for t in range(len(triangles)):
        (ax, ay), (bx, by), (cx, cy) = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        twice = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        if twice == 0.0:
            continue
        for i in range(int(min(ax, bx, cx)), int(max(ax, bx, cx)) + 1):
            for j in range(int(min(ay, by, cy)), int(max(ay, by, cy)) + 1):
                x, y = i + 0.5, j + 0.5
                u = ((bx - x) * (cy - y) - (by - y) * (cx - x)) / twice
                v = ((cx - x) * (ay - y) - (cy - y) * (ax - x)) / twice
                if u >= 0.0 and v >= 0.0 and u + v <= 1.0:
                    seen[i, j] = True
    return seen.sum()
