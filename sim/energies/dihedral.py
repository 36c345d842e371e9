"""The dihedral angle of a hinge and its first and second derivatives, for Numba kernels.

A hinge has four corners x0..x3: the shared edge x0-x1 and the opposite corners, with triangles
(x0, x1, x2) and (x1, x0, x3). The angle is 0 when flat and positive when the normals diverge
around the edge x0 -> x1. With e the edge and N the unnormalised normal of a triangle, the gradient
at its opposite corner is -|e| N/|N|²; invariance under rigid motions gives those at x0 and x1.
"""

import numba
import numpy as np


@numba.njit(cache=True)
def angle(x):
    """Dihedral angle, rad, of corners x (4, 3) m, in (-pi, pi]."""
    ex, ey, ez = x[1, 0] - x[0, 0], x[1, 1] - x[0, 1], x[1, 2] - x[0, 2]
    ax, ay, az = x[2, 0] - x[0, 0], x[2, 1] - x[0, 1], x[2, 2] - x[0, 2]
    bx, by, bz = x[3, 0] - x[0, 0], x[3, 1] - x[0, 1], x[3, 2] - x[0, 2]
    nx, ny, nz = ey * az - ez * ay, ez * ax - ex * az, ex * ay - ey * ax
    mx, my, mz = by * ez - bz * ey, bz * ex - bx * ez, bx * ey - by * ex
    # (N × M)·e/|e| = |e| (N·b) because M = b × e and N is normal to e
    sine = (nx * bx + ny * by + nz * bz) * np.sqrt(ex * ex + ey * ey + ez * ez)
    return np.arctan2(-sine, nx * mx + ny * my + nz * mz)


@numba.njit(inline="always")
def side_levers(edge, arm, double_area):
    """Derivatives along the unit normal of the rotation of a triangle about an edge, relative to a
    frame transported with the edge, by start, end and corner, 1/m. ``edge`` and ``arm`` (3,) are
    the vectors from the start to end and corner."""
    square = edge[0] * edge[0] + edge[1] * edge[1] + edge[2] * edge[2]
    share = (arm[0] * edge[0] + arm[1] * edge[1] + arm[2] * edge[2]) / square
    slope = -np.sqrt(square) / double_area  # -1/height
    return (share - 1.0) * slope, -share * slope, slope


@numba.njit(inline="always")
def add_side_bends(edge, arm, weight, order, bends):
    """Add ``weight`` times the second derivatives of the rotation of :func:`side_levers`.

    ``order`` (3,) places start, end and corner in ``bends`` (P, P, 3): with n the unit normal, the
    second derivatives by two points p and r are n w_pr^T + w_rp n^T with vectors w of the plane.

    With u along the edge of length l, m from the edge to the corner at the height d, and t the foot
    of that height on the edge, the gradient at the corner is g = -n/d, and those at end and start
    are -t g and -(1 - t) g. Only n, d and t vary, which gives vectors of three kinds: m/d²,
    u/(d l), and m/(2 l²), the symmetric part of m/l²; the skew part cancels between the two
    triangles at an edge.
    """
    square = edge[0] * edge[0] + edge[1] * edge[1] + edge[2] * edge[2]
    t = (arm[0] * edge[0] + arm[1] * edge[1] + arm[2] * edge[2]) / square
    r = 1.0 - t
    up = arm[0] - t * edge[0], arm[1] - t * edge[1], arm[2] - t * edge[2]
    height = np.sqrt(up[0] * up[0] + up[1] * up[1] + up[2] * up[2])
    start, end, corner = order
    for k in range(3):
        high = weight * up[k] / height**3  # m/d²
        long = weight * edge[k] / (height * square)  # u/(d l)
        mixed = 0.5 * weight * up[k] / (height * square)  # m/(2 l²)
        bends[corner, corner, k] += high
        bends[corner, end, k] -= t * high
        bends[end, corner, k] += long - t * high
        bends[corner, start, k] -= r * high
        bends[start, corner, k] -= long + r * high
        bends[end, end, k] += t * (t * high - long) + mixed
        bends[end, start, k] += r * (t * high - long) - mixed
        bends[start, end, k] += t * (r * high + long) - mixed
        bends[start, start, k] += r * (r * high + long) + mixed
