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


@numba.njit(cache=True)
def add_side_gradient(x, corner, sign, g):
    """Add to g (4, 3) the derivatives of one triangle's rotation about the edge by its corners,
    relative to a frame transported with the edge; ``corner`` 2 has the ``sign`` 1, 3 the sign -1.
    """
    ex, ey, ez = x[1, 0] - x[0, 0], x[1, 1] - x[0, 1], x[1, 2] - x[0, 2]
    ee = ex * ex + ey * ey + ez * ez
    ax, ay, az = x[corner, 0] - x[0, 0], x[corner, 1] - x[0, 1], x[corner, 2] - x[0, 2]
    nx, ny, nz = ey * az - ez * ay, ez * ax - ex * az, ex * ay - ey * ax
    scale = -sign * np.sqrt(ee) / (nx * nx + ny * ny + nz * nz)
    at_corner = scale * nx, scale * ny, scale * nz
    t = (ax * ex + ay * ey + az * ez) / ee
    for k in range(3):
        g[corner, k] += at_corner[k]
        g[1, k] -= t * at_corner[k]
        g[0, k] -= (1.0 - t) * at_corner[k]


@numba.njit(cache=True)
def add_side_hessian(x, corner, sign, weight, first, frame, block):
    """Add ``weight`` times one triangle's part of the second derivatives of the angle.

    ``corner`` and ``sign`` are those of :func:`add_side_gradient`. The rows and columns of corner c
    in ``block`` start at first[c]; ``frame`` (3, 3) is scratch memory.

    With n its unit normal, u along the edge of length l, m from the edge to the opposite
    ``corner`` (2 or 3) at the height d, and t the foot of that height on the edge, the gradient
    at the corner is g = -n/d, and those at x1 and x0 are -t g and -(1 - t) g. Only n, d and t vary,
    which gives three dyads:

        A = (n m^T + m n^T)/d²,   B = n u^T/(d l),   M = (n m^T + m n^T)/(2 l²).

    M is the symmetric part of n m^T/l²; the skew part cancels between the two triangles.
    """
    n, m, u = frame[0], frame[1], frame[2]
    ee = ae = 0.0
    for k in range(3):
        u[k] = x[1, k] - x[0, k]
        m[k] = x[corner, k] - x[0, k]
        ee += u[k] * u[k]
        ae += u[k] * m[k]
    n[0] = sign * (u[1] * m[2] - u[2] * m[1])
    n[1] = sign * (u[2] * m[0] - u[0] * m[2])
    n[2] = sign * (u[0] * m[1] - u[1] * m[0])
    double_area = np.sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2])
    length = np.sqrt(ee)
    height = double_area / length
    t = ae / ee
    for k in range(3):
        n[k] /= double_area
        m[k] = (m[k] - t * u[k]) / height
        u[k] /= length
    r = 1.0 - t
    by_height = weight / (height * height)
    by_both = weight / (height * length)
    by_length = 0.5 * weight / ee
    p0, p1, c = first[0], first[1], first[corner]
    for i in range(3):
        for j in range(3):
            dyad = n[i] * m[j] + m[i] * n[j]
            a, mixed = by_height * dyad, by_length * dyad
            b, transposed = by_both * n[i] * u[j], by_both * u[i] * n[j]
            block[c + i, c + j] += a
            block[p1 + i, c + j] += b - t * a
            block[c + i, p1 + j] += transposed - t * a
            block[p0 + i, c + j] -= r * a + b
            block[c + i, p0 + j] -= r * a + transposed
            block[p1 + i, p1 + j] += t * t * a - t * (b + transposed) + mixed
            block[p1 + i, p0 + j] += t * r * a - r * b + t * transposed - mixed
            block[p0 + i, p1 + j] += t * r * a - r * transposed + t * b - mixed
            block[p0 + i, p0 + j] += r * r * a + r * (b + transposed) + mixed
