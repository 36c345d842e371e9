"""The rasteriser of :mod:`data.render.rasterise` as compiled loops, for CPUs."""

from concurrent.futures import ThreadPoolExecutor
from math import isfinite

import numba
import numpy as np

MIN_HEIGHT = 1e-12  # px, avoids division by 0 in the slope of a horizontal edge


def rasterise_arrays(
    points: np.ndarray,
    faces: np.ndarray,
    intrinsics: np.ndarray,
    *,
    height: int,
    width: int,
    threads: int = 1,
) -> np.ndarray:
    """Depth pictures (B, K, height, width) of B meshes, K of each.

    Args:
        points: (B, K, V, 3) vertices in camera axes, m.
        faces: (B, F, 3) int64, of existing vertices; intrinsics: (B, K, 4) fx, fy, cx, cy, px.
        threads: without influence on the result.

    Returns:
        z-depth in metres, background 0, of the type of ``points``.
    """
    pictures = np.zeros((*points.shape[:2], height, width), dtype=points.dtype)

    def work(mesh: int) -> None:
        _draw(points[mesh], faces[mesh], intrinsics[mesh], pictures[mesh])

    # Python threads: those of numba and OpenMP do not survive the fork of a data loader's workers.
    if threads == 1 or len(points) == 1:
        for mesh in range(len(points)):
            work(mesh)
    else:
        with ThreadPoolExecutor(threads) as pool:
            list(pool.map(work, range(len(points))))
    return pictures


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _draw(points, faces, intrinsics, pictures):
    """Draw a mesh into its pictures (K, H, W), initially zeros."""
    views, vertices, _ = points.shape
    height, width = pictures.shape[1:]
    u = np.empty(vertices, points.dtype)
    v, w = np.empty_like(u), np.empty_like(u)
    for view in range(views):
        fx, fy, cx, cy = intrinsics[view]
        for i in range(vertices):
            x, y, z = points[view, i]
            w[i] = 1 / z if z > 0 else np.nan
            u[i] = fx * x * w[i] + cx
            v[i] = fy * y * w[i] + cy
        nearest = pictures[view]
        for face in range(len(faces)):
            _draw_triangle(u, v, w, faces[face], nearest)
        for row in range(height):
            for column in range(width):
                if nearest[row, column] > 0:
                    nearest[row, column] = 1 / nearest[row, column]


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _draw_triangle(u, v, w, face, nearest):
    """Draw a triangle with corners (u, v, 1/z = w) into a picture of the largest 1/z."""
    height, width = nearest.shape
    a, b, c = face
    if v[a] > v[b]:
        a, b = b, a
    if v[b] > v[c]:
        b, c = c, b
    if v[a] > v[b]:
        a, b = b, a
    if not isfinite(u[a] + u[b] + u[c] + v[a] + v[b] + v[c] + w[a] + w[b] + w[c]):
        return
    # Clamped before conversion: far outside the picture they could overflow an integer.
    first, last = max(np.ceil(v[a]), 0), min(np.floor(v[c]), height - 1)
    for row in range(int(first), int(last) + 1):
        left, w_left = _cross(u, v, w, a, c, row)
        upper, lower = (a, b) if row < v[b] else (b, c)
        right, w_right = _cross(u, v, w, upper, lower, row)
        if left > right:
            left, w_left, right, w_right = right, w_right, left, w_left
        slope = (w_right - w_left) / (right - left) if right > left else w_left * 0
        begin, end = max(np.ceil(left), 0), min(np.floor(right), width - 1)
        for column in range(int(begin), int(end) + 1):
            inverse_depth = w_left + slope * (nearest.dtype.type(column) - left)
            if inverse_depth > nearest[row, column]:
                nearest[row, column] = inverse_depth


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _cross(u, v, w, upper, lower, row):
    """Column and 1/z of an edge's intersection with a row."""
    down = max(v[lower] - v[upper], v.dtype.type(MIN_HEIGHT))
    below = v.dtype.type(row) - v[upper]
    slope, slope_w = (u[lower] - u[upper]) / down, (w[lower] - w[upper]) / down
    return u[upper] + slope * below, w[upper] + slope_w * below
