"""The dihedral angle of a hinge and its first and second derivatives, for Numba kernels.

A hinge has four corners x0..x3: the shared edge x0-x1 and the opposite corners, with triangles
(x0, x1, x2) and (x1, x0, x3). The angle is 0 when flat and positive when the normals diverge
around the edge x0 -> x1. Derivatives are closed forms: with e the edge and N the unnormalised
normal of a triangle, the gradient at its opposite corner is -|e| N/|N|², and the gradients at
x0, x1 follow from rigid motions leaving the angle unchanged.
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


@numba.njit(cache=True)
def gradient(x, g):
    """Fill g (4, 3) with the derivatives of the angle by the corners x (4, 3)."""
    ex, ey, ez = x[1, 0] - x[0, 0], x[1, 1] - x[0, 1], x[1, 2] - x[0, 2]
    ee = ex * ex + ey * ey + ez * ez
    length = np.sqrt(ee)
    for side in range(2):
        c = 2 + side
        ax, ay, az = x[c, 0] - x[0, 0], x[c, 1] - x[0, 1], x[c, 2] - x[0, 2]
        nx, ny, nz = ey * az - ez * ay, ez * ax - ex * az, ex * ay - ey * ax
        scale = -length / (nx * nx + ny * ny + nz * nz)
        if side == 1:
            scale = -scale
        g[c, 0], g[c, 1], g[c, 2] = scale * nx, scale * ny, scale * nz
        t = (ax * ex + ay * ey + az * ez) / ee
        for k in range(3):
            if side == 0:
                g[1, k] = -t * g[c, k]
                g[0, k] = -(1.0 - t) * g[c, k]
            else:
                g[1, k] -= t * g[c, k]
                g[0, k] -= (1.0 - t) * g[c, k]


@numba.njit(cache=True)
def _side(e, a, sign, foot, rows, h, other):
    """Add one triangle's part of the second derivatives of the angle to h (12, 12).

    The triangle has the edge vector e, the vector a from x0 to its opposite corner ``other`` (2
    or 3), and the normal N = sign e × a. With g = -|e| N/|N|² the gradient at that corner and t
    the foot of its height on the edge, the gradients at x1 and x0 get -t g and -(1 - t) g.
    ``foot`` (3, 3) and ``rows`` (3, 3, 3) are scratch for the derivatives of t and g by
    x0, x1 and the opposite corner.
    """
    nx = sign * (e[1] * a[2] - e[2] * a[1])
    ny = sign * (e[2] * a[0] - e[0] * a[2])
    nz = sign * (e[0] * a[1] - e[1] * a[0])
    n = (nx, ny, nz)
    ee = e[0] * e[0] + e[1] * e[1] + e[2] * e[2]
    nn = nx * nx + ny * ny + nz * nz
    scale = -np.sqrt(ee) / nn
    t = (a[0] * e[0] + a[1] * e[1] + a[2] * e[2]) / ee
    # N changes by sign e × da + sign de × a; N·(e × da) = (N × e)·da, N·(de × a) = (a × N)·de
    twice = 2.0 * sign / nn
    by_a = (
        twice * (ny * e[2] - nz * e[1]),
        twice * (nz * e[0] - nx * e[2]),
        twice * (nx * e[1] - ny * e[0]),
    )
    by_e = (
        twice * (a[1] * nz - a[2] * ny) - e[0] / ee,
        twice * (a[2] * nx - a[0] * nz) - e[1] / ee,
        twice * (a[0] * ny - a[1] * nx) - e[2] / ee,
    )
    for i in range(3):
        foot[2, i] = e[i] / ee
        foot[1, i] = (a[i] - 2.0 * t * e[i]) / ee
        foot[0, i] = -foot[1, i] - foot[2, i]
        for k in range(3):
            rows[2, i, k] = -scale * n[i] * by_a[k]
            rows[1, i, k] = -scale * n[i] * by_e[k]
        j, k = (i + 1) % 3, (i + 2) % 3
        # the cross products themselves: (e × da)_i = e_j da_k - e_k da_j
        rows[2, i, k] += scale * sign * e[j]
        rows[2, i, j] -= scale * sign * e[k]
        rows[1, i, j] += scale * sign * a[k]
        rows[1, i, k] -= scale * sign * a[j]
    for i in range(3):
        for k in range(3):
            rows[0, i, k] = -rows[1, i, k] - rows[2, i, k]
    for c in range(3):
        column = 3 * other if c == 2 else 3 * c
        for i in range(3):
            for k in range(3):
                first = rows[c, i, k]
                second = t * first + scale * n[i] * foot[c, k]
                h[3 * other + i, column + k] += first
                h[3 + i, column + k] -= second
                h[i, column + k] -= first - second


@numba.njit(cache=True)
def hessian(x, h, foot, rows):
    """Fill h (12, 12) with the second derivatives of the angle by x (4, 3) flattened.

    ``foot`` (3, 3) and ``rows`` (3, 3, 3) are scratch.
    """
    e, a, b = np.empty(3), np.empty(3), np.empty(3)
    for k in range(3):
        e[k] = x[1, k] - x[0, k]
        a[k] = x[2, k] - x[0, k]
        b[k] = x[3, k] - x[0, k]
    h[:, :] = 0.0
    _side(e, a, 1.0, foot, rows, h, 2)
    _side(e, b, -1.0, foot, rows, h, 3)
