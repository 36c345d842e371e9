"""In-plane stiffness: isotropic corotational elasticity of constant-strain triangles."""

import numba
import numpy as np

from sim.energies.base import Energy
from sim.energies.strain import triangle_elements
from sim.mesh import Mesh


class CorotationalMembrane(Energy):
    """Energy A (mu |F - R|² + lambda/2 tr(R^T F - I)²) of every triangle (section 4.1).

    F (3, 2) is the deformation gradient, R its closest isometry, A the rest area. In terms of
    the singular values s of F: mu ((s1-1)² + (s2-1)²) + lambda/2 (s1+s2-2)².

    Args:
        mesh: the specimen.
        active: (F,) bool, triangles that store energy.
        stiffness: Young's modulus times thickness, N/m; 200 as in the paper.
        poisson: Poisson's ratio in the plane.

    Attributes:
        areas, shape: of the N triangles, see :func:`sim.energies.strain.triangle_elements`.
        mu, lam: N/m.
    """

    def __init__(
        self, mesh: Mesh, active: np.ndarray, *, stiffness: float = 200.0, poisson: float = 0.3
    ) -> None:
        self.dofs, self.areas, self.shape = triangle_elements(mesh, active)
        self.mu = stiffness / (2 * (1 + poisson))
        self.lam = stiffness * poisson / (1 - poisson**2)

    def value(self, q: np.ndarray) -> float:
        return _value(q, self.dofs, self.shape, self.areas, self.mu, self.lam)

    def gradient(self, q: np.ndarray) -> np.ndarray:
        return _gradient(q, self.dofs, self.shape, self.areas, self.mu, self.lam)

    def hessian(self, q: np.ndarray, convex: bool = False) -> np.ndarray:
        return _hessian(q, self.dofs, self.shape, self.areas, self.mu, self.lam, convex)

    def stretches(self, q: np.ndarray) -> np.ndarray:
        """(N, 2) singular values of the deformation gradients, larger first."""
        return _stretches(q, self.dofs, self.shape)


@numba.njit(cache=True)
def _deform(q, dofs, shape, f):
    """Fill f (2, 3) with the columns of one F.

    Returns half the difference of their squares, their product, and half the sum of the squares.
    """
    square = cross = other = 0.0
    for i in range(3):
        x0, x1, x2 = q[dofs[i]], q[dofs[3 + i]], q[dofs[6 + i]]
        f[0, i] = x0 * shape[0, 0] + x1 * shape[1, 0] + x2 * shape[2, 0]
        f[1, i] = x0 * shape[0, 1] + x1 * shape[1, 1] + x2 * shape[2, 1]
        square += f[0, i] * f[0, i]
        cross += f[0, i] * f[1, i]
        other += f[1, i] * f[1, i]
    return 0.5 * (square - other), cross, 0.5 * (square + other)


@numba.njit(cache=True)
def _svd(q, dofs, shape, f, v, frame):
    """Singular values s1 >= s2 of one F; frame (3, 3) gets u1, u2, n, v (2, 2) the right vectors.

    f (2, 3) is scratch.
    """
    half, cross, mean = _deform(q, dofs, shape, f)
    angle = 0.5 * np.arctan2(cross, half)
    v[0, 0] = v[1, 1] = np.cos(angle)
    v[0, 1] = np.sin(angle)
    v[1, 0] = -v[0, 1]
    s1 = np.sqrt(mean + np.hypot(half, cross))
    square = 0.0
    for i in range(3):
        frame[0, i] = (f[0, i] * v[0, 0] + f[1, i] * v[0, 1]) / s1
        frame[1, i] = f[0, i] * v[1, 0] + f[1, i] * v[1, 1]
        square += frame[1, i] * frame[1, i]
    s2 = np.sqrt(square)
    for i in range(3):
        frame[1, i] /= max(s2, 1e-12)
    frame[2, 0] = frame[0, 1] * frame[1, 2] - frame[0, 2] * frame[1, 1]
    frame[2, 1] = frame[0, 2] * frame[1, 0] - frame[0, 0] * frame[1, 2]
    frame[2, 2] = frame[0, 0] * frame[1, 1] - frame[0, 1] * frame[1, 0]
    return s1, s2


@numba.njit(cache=True)
def _singular_values(q, dofs, shape, f):
    """Singular values s1 >= s2 of one F; f (2, 3) is scratch."""
    half, cross, mean = _deform(q, dofs, shape, f)
    s1 = np.sqrt(mean + np.hypot(half, cross))
    a = f[0, 1] * f[1, 2] - f[0, 2] * f[1, 1]
    b = f[0, 2] * f[1, 0] - f[0, 0] * f[1, 2]
    c = f[0, 0] * f[1, 1] - f[0, 1] * f[1, 0]
    return s1, np.sqrt(a * a + b * b + c * c) / s1


@numba.njit(cache=True)
def _stretches(q, dofs, shape):
    result = np.empty((len(dofs), 2))
    f = np.empty((2, 3))
    for t in range(len(dofs)):
        result[t, 0], result[t, 1] = _singular_values(q, dofs[t], shape[t], f)
    return result


@numba.njit(cache=True)
def _value(q, dofs, shape, areas, mu, lam):
    total = 0.0
    f = np.empty((2, 3))
    for t in range(len(dofs)):
        s1, s2 = _singular_values(q, dofs[t], shape[t], f)
        trace = s1 + s2 - 2.0
        total += areas[t] * (mu * ((s1 - 1.0) ** 2 + (s2 - 1.0) ** 2) + 0.5 * lam * trace**2)
    return total


@numba.njit(cache=True)
def _gradient(q, dofs, shape, areas, mu, lam):
    result = np.empty((len(dofs), 9))
    f, v, frame = np.empty((2, 3)), np.empty((2, 2)), np.empty((3, 3))
    for t in range(len(dofs)):
        s1, s2 = _svd(q, dofs[t], shape[t], f, v, frame)
        trace = s1 + s2 - 2.0
        p1 = areas[t] * (2.0 * mu * (s1 - 1.0) + lam * trace)
        p2 = areas[t] * (2.0 * mu * (s2 - 1.0) + lam * trace)
        for a in range(3):
            w1 = p1 * (v[0, 0] * shape[t, a, 0] + v[0, 1] * shape[t, a, 1])
            w2 = p2 * (v[1, 0] * shape[t, a, 0] + v[1, 1] * shape[t, a, 1])
            for i in range(3):
                result[t, 3 * a + i] = w1 * frame[0, i] + w2 * frame[1, i]
    return result


@numba.njit(cache=True)
def _hessian(q, dofs, shape, areas, mu, lam, convex):
    # The Hessian of an isotropic energy by F has a known eigenbasis: scalings u_i v_i, a twist,
    # a flip, and the two out-of-plane rotations n v_i, whose eigenvalues are stress/stretch.
    result = np.empty((len(dofs), 9, 9))
    mode = np.empty((6, 9))
    value = np.empty(6)
    root = np.sqrt(0.5)
    f, v, frame = np.empty((2, 3)), np.empty((2, 2)), np.empty((3, 3))
    for t in range(len(dofs)):
        s1, s2 = _svd(q, dofs[t], shape[t], f, v, frame)
        trace = s1 + s2 - 2.0
        p1 = 2.0 * mu * (s1 - 1.0) + lam * trace
        p2 = 2.0 * mu * (s2 - 1.0) + lam * trace
        value[0] = value[1] = 2.0 * mu + lam
        value[2] = (p1 + p2) / (s1 + s2)
        value[3] = 2.0 * mu
        value[4] = p1 / s1
        value[5] = p2 / max(s2, 1e-12)
        if convex:
            for k in range(6):
                value[k] = max(value[k], 0.0)
        for a in range(3):
            w1 = v[0, 0] * shape[t, a, 0] + v[0, 1] * shape[t, a, 1]
            w2 = v[1, 0] * shape[t, a, 0] + v[1, 1] * shape[t, a, 1]
            for i in range(3):
                k = 3 * a + i
                mode[0, k] = frame[0, i] * w1
                mode[1, k] = frame[1, i] * w2
                mode[2, k] = root * (frame[1, i] * w1 - frame[0, i] * w2)
                mode[3, k] = root * (frame[1, i] * w1 + frame[0, i] * w2)
                mode[4, k] = frame[2, i] * w1
                mode[5, k] = frame[2, i] * w2
        for i in range(9):
            for j in range(i, 9):
                h = lam * (mode[0, i] * mode[1, j] + mode[1, i] * mode[0, j])
                for k in range(6):
                    h += value[k] * mode[k, i] * mode[k, j]
                result[t, i, j] = result[t, j, i] = areas[t] * h
    return result
