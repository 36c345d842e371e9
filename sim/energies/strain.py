"""In-plane energies given by a law of the Green strain in warp and weft axes."""

from typing import Protocol

import numba
import numpy as np

from sim.energies.base import Energy
from sim.mesh import Mesh


class StrainLaw(Protocol):
    """Energy per rest area as a function of the Green strain.

    A strain (N, 3) holds E_uu, E_vv and 2 E_uv, with u along warp and v along weft:
    E = (F^T F - I)/2. Its stress (N, 3), N/m, is S_uu, S_vv, S_uv (second Piola-Kirchhoff times
    thickness).
    """

    def density(self, strain: np.ndarray) -> np.ndarray:
        """(N,) J/m²."""

    def stress(self, strain: np.ndarray) -> np.ndarray:
        """(N, 3) derivative of the energy, N/m."""

    def tangent(self, strain: np.ndarray) -> np.ndarray:
        """(N, 3, 3) second derivative of the energy, N/m, symmetric."""


def triangle_elements(
    mesh: Mesh, active: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Unknowns (N, 9), rest areas (N,) and shape (N, 3, 2), 1/m, of the triangles ``active``.

    The deformation gradient F (3, 2) is the sum over corners of x_a (outer) shape_a.
    """
    faces = mesh.faces[active]
    dofs = (3 * faces[:, :, None] + np.arange(3)).reshape(-1, 9)
    a, b, c = (mesh.rest[faces[:, i]] for i in range(3))
    inverse = np.linalg.inv(np.stack([b - a, c - a], axis=-1))
    return dofs, mesh.areas[active], np.concatenate([-inverse.sum(1, keepdims=True), inverse], 1)


class StrainMembrane(Energy):
    """Rest area times the energy of a :class:`StrainLaw`, for every triangle.

    The Hessian is B^T C B with the law's tangent C and the strain's derivative B, plus the
    stress times the second derivative of the strain. At full convexity the tangent and the
    stress tensor lose their negative eigenvalues, which leaves two semi-definite terms.

    Args:
        mesh: the specimen.
        active: (F,) bool, triangles that store energy.
        law: in the axes of ``mesh.rest``, warp along x and weft along y.
    """

    def __init__(self, mesh: Mesh, active: np.ndarray, law: StrainLaw) -> None:
        self.law = law
        self.dofs, self._areas, self._shape = triangle_elements(mesh, active)

    def value(self, q: np.ndarray) -> float:
        return float(self._areas @ self.law.density(self.strains(q)))

    def gradient(self, q: np.ndarray) -> np.ndarray:
        stress = self.law.stress(self.strains(q))
        return _gradient(q, self.dofs, self._shape, self._areas, stress)

    def hessian(self, q: np.ndarray, convex: bool = False) -> np.ndarray:
        strain = self.strains(q)
        stress, tangent = self.law.stress(strain), self.law.tangent(strain)
        if convex:
            tensor = _without_negative(stress[:, [[0, 2], [2, 1]]])
            stress = tensor[:, [0, 1, 0], [0, 1, 1]]
            tangent = _without_negative(tangent)
        return _hessian(q, self.dofs, self._shape, self._areas, stress, tangent)

    def strains(self, q: np.ndarray) -> np.ndarray:
        """(N, 3) Green strains E_uu, E_vv, 2 E_uv of the triangles."""
        return _strains(q, self.dofs, self._shape)


def _without_negative(matrices: np.ndarray) -> np.ndarray:
    """Symmetric matrices (N, K, K) without their negative eigenvalues."""
    values, vectors = np.linalg.eigh(matrices)
    return (vectors * np.maximum(values, 0.0)[:, None, :]) @ np.swapaxes(vectors, 1, 2)


@numba.njit(cache=True)
def _deformation(q, dofs, shape, f):
    """The deformation gradient of one triangle, written to f (3, 2)."""
    for i in range(3):
        f[i, 0] = f[i, 1] = 0.0
        for a in range(3):
            x = q[dofs[3 * a + i]]
            f[i, 0] += x * shape[a, 0]
            f[i, 1] += x * shape[a, 1]


@numba.njit(cache=True)
def _strains(q, dofs, shape):
    result = np.empty((len(dofs), 3))
    f = np.empty((3, 2))
    for t in range(len(dofs)):
        _deformation(q, dofs[t], shape[t], f)
        uu = uv = vv = 0.0
        for i in range(3):
            uu += f[i, 0] * f[i, 0]
            uv += f[i, 0] * f[i, 1]
            vv += f[i, 1] * f[i, 1]
        result[t, 0] = 0.5 * (uu - 1.0)
        result[t, 1] = 0.5 * (vv - 1.0)
        result[t, 2] = uv
    return result


@numba.njit(cache=True)
def _gradient(q, dofs, shape, areas, stress):
    result = np.empty((len(dofs), 9))
    f = np.empty((3, 2))
    for t in range(len(dofs)):
        _deformation(q, dofs[t], shape[t], f)
        for a in range(3):
            gu, gv = shape[t, a]
            wu = areas[t] * (stress[t, 0] * gu + stress[t, 2] * gv)
            wv = areas[t] * (stress[t, 2] * gu + stress[t, 1] * gv)
            for i in range(3):
                result[t, 3 * a + i] = wu * f[i, 0] + wv * f[i, 1]
    return result


@numba.njit(cache=True)
def _hessian(q, dofs, shape, areas, stress, tangent):
    result = np.empty((len(dofs), 9, 9))
    f = np.empty((3, 2))
    b = np.empty((3, 9))  # derivative of the strain by the corners
    cb = np.empty((3, 9))
    for t in range(len(dofs)):
        _deformation(q, dofs[t], shape[t], f)
        for a in range(3):
            gu, gv = shape[t, a]
            for i in range(3):
                b[0, 3 * a + i] = f[i, 0] * gu
                b[1, 3 * a + i] = f[i, 1] * gv
                b[2, 3 * a + i] = f[i, 0] * gv + f[i, 1] * gu
        for m in range(3):
            for j in range(9):
                cb[m, j] = areas[t] * (
                    tangent[t, m, 0] * b[0, j]
                    + tangent[t, m, 1] * b[1, j]
                    + tangent[t, m, 2] * b[2, j]
                )
        for i in range(9):
            for j in range(i, 9):
                h = b[0, i] * cb[0, j] + b[1, i] * cb[1, j] + b[2, i] * cb[2, j]
                result[t, i, j] = result[t, j, i] = h
        for a in range(3):
            wu = areas[t] * (stress[t, 0] * shape[t, a, 0] + stress[t, 2] * shape[t, a, 1])
            wv = areas[t] * (stress[t, 2] * shape[t, a, 0] + stress[t, 1] * shape[t, a, 1])
            for c in range(3):
                h = wu * shape[t, c, 0] + wv * shape[t, c, 1]
                for i in range(3):
                    result[t, 3 * a + i, 3 * c + i] += h
    return result
