"""In-plane stiffness: isotropic corotational elasticity of constant-strain triangles."""

import numba
import numpy as np

from sim.energies.base import blend_eigenvalue
from sim.energies.strain import triangle_elements
from sim.mesh import Mesh

_blend = numba.njit(inline="always")(blend_eigenvalue)


class CorotationalMembrane:
    """Energy A (mu |F - R|² + lambda/2 tr(R^T F - I)²) of every triangle (section 4.1).

    F (3, 2) is the deformation gradient, R its closest isometry, A the rest area. In terms of
    the singular values s of F: mu ((s1-1)² + (s2-1)²) + lambda/2 (s1+s2-2)².

    Args:
        mesh: the specimen.
        active: (F,) bool, triangles that store energy.
        stiffness: Young's modulus times thickness, N/m; 200 as in the paper.
        poisson: Poisson's ratio in the plane.
    """

    def __init__(
        self, mesh: Mesh, active: np.ndarray, *, stiffness: float = 200.0, poisson: float = 0.3
    ) -> None:
        self.dofs, self._areas, self._shape = triangle_elements(mesh, active)
        self._mu = stiffness / (2 * (1 + poisson))
        self._lam = stiffness * poisson / (1 - poisson**2)

    def value(self, q: np.ndarray) -> float:
        return _value(q, self.dofs, self._shape, self._areas, self._mu, self._lam)

    def gradient(self, q: np.ndarray) -> np.ndarray:
        return _gradient(q, self.dofs, self._shape, self._areas, self._mu, self._lam)

    def hessian(self, q: np.ndarray, convexity: float) -> np.ndarray:
        return _hessian(q, self.dofs, self._shape, self._areas, self._mu, self._lam, convexity)

    def allows(self, old: np.ndarray, new: np.ndarray) -> bool:
        return True

    def stretches(self, q: np.ndarray) -> np.ndarray:
        """(N, 2) singular values of the deformation gradients, larger first."""
        return _stretches(q, self.dofs, self._shape)


@numba.njit(cache=True)
def _svd(q, dofs, shape):
    """Frame (3, 3) with rows u1, u2, n, right vectors (2, 2) as rows, s1 >= s2 of one F."""
    f = np.zeros((3, 2))
    for a in range(3):
        for i in range(3):
            x = q[dofs[3 * a + i]]
            f[i, 0] += x * shape[a, 0]
            f[i, 1] += x * shape[a, 1]
    c00 = c01 = c11 = 0.0
    for i in range(3):
        c00 += f[i, 0] * f[i, 0]
        c01 += f[i, 0] * f[i, 1]
        c11 += f[i, 1] * f[i, 1]
    half = 0.5 * (c00 - c11)
    root = np.hypot(half, c01)
    mean = 0.5 * (c00 + c11)
    angle = 0.5 * np.arctan2(c01, half)
    v = np.empty((2, 2))
    v[0, 0] = np.cos(angle)
    v[0, 1] = np.sin(angle)
    v[1, 0] = -v[0, 1]
    v[1, 1] = v[0, 0]
    s1 = np.sqrt(mean + root)
    frame = np.empty((3, 3))
    w = np.empty(3)
    for i in range(3):
        frame[0, i] = (f[i, 0] * v[0, 0] + f[i, 1] * v[0, 1]) / s1
        w[i] = f[i, 0] * v[1, 0] + f[i, 1] * v[1, 1]
    s2 = np.sqrt(w[0] * w[0] + w[1] * w[1] + w[2] * w[2])
    for i in range(3):
        frame[1, i] = w[i] / max(s2, 1e-12)
    frame[2, 0] = frame[0, 1] * frame[1, 2] - frame[0, 2] * frame[1, 1]
    frame[2, 1] = frame[0, 2] * frame[1, 0] - frame[0, 0] * frame[1, 2]
    frame[2, 2] = frame[0, 0] * frame[1, 1] - frame[0, 1] * frame[1, 0]
    return frame, v, s1, s2


@numba.njit(cache=True)
def _stretches(q, dofs, shape):
    result = np.empty((len(dofs), 2))
    for t in range(len(dofs)):
        _, _, result[t, 0], result[t, 1] = _svd(q, dofs[t], shape[t])
    return result


@numba.njit(cache=True)
def _value(q, dofs, shape, areas, mu, lam):
    total = 0.0
    for t in range(len(dofs)):
        _, _, s1, s2 = _svd(q, dofs[t], shape[t])
        trace = s1 + s2 - 2.0
        total += areas[t] * (mu * ((s1 - 1.0) ** 2 + (s2 - 1.0) ** 2) + 0.5 * lam * trace**2)
    return total


@numba.njit(cache=True)
def _gradient(q, dofs, shape, areas, mu, lam):
    result = np.empty((len(dofs), 9))
    for t in range(len(dofs)):
        frame, v, s1, s2 = _svd(q, dofs[t], shape[t])
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
def _hessian(q, dofs, shape, areas, mu, lam, convexity):
    # The Hessian of an isotropic energy by F has a known eigenbasis: scalings u_i v_i, a twist,
    # a flip, and the two out-of-plane rotations n v_i, whose eigenvalues are stress/stretch.
    result = np.empty((len(dofs), 9, 9))
    mode = np.empty((6, 9))
    value = np.empty(6)
    root = np.sqrt(0.5)
    for t in range(len(dofs)):
        frame, v, s1, s2 = _svd(q, dofs[t], shape[t])
        trace = s1 + s2 - 2.0
        p1 = 2.0 * mu * (s1 - 1.0) + lam * trace
        p2 = 2.0 * mu * (s2 - 1.0) + lam * trace
        value[0] = value[1] = 2.0 * mu + lam
        value[2] = _blend((p1 + p2) / (s1 + s2), convexity)
        value[3] = 2.0 * mu
        value[4] = _blend(p1 / s1, convexity)
        value[5] = _blend(p2 / max(s2, 1e-12), convexity)
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
