"""In-plane energy: constant-strain triangles, and the materials of membranes.

Stiffnesses are those of cloth of 300 g/m², at which drapes are simulated. A material is a law of
its strain: the Green strain (N, 3) in warp and weft axes, E_uu, E_vv and 2 E_uv with u along warp,
v along weft and E = (F^T F - I)/2, or for the corotational one the principal stretches less 1
(N, 2). The stress of the Green strain is S_uu, S_vv, S_uv (second Piola-Kirchhoff times thickness).
"""

from abc import abstractmethod
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol, runtime_checkable

import numba
import numpy as np

from common.errors import InputError
from common.types import FaceMask, StateVector
from sim.energies.base import Energy, FusedEnergy, raise_eigenvalues
from sim.material import MEMBRANE_STIFFNESS
from sim.mesh import Mesh
from sim.solver.linear import add_block

EQUAL = 1e-9  # difference of stretches below which they count as equal


class StrainLaw(Protocol):
    """Energy per rest area as a function of a strain."""

    def response(self, strain: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Density (N,), J/m², stress (N, K), N/m, and tangent (N, K, K), N/m, the derivatives."""


class StrainMembrane(FusedEnergy):
    """Rest area times the density of a :class:`StrainLaw`, for every triangle.

    The Hessian is B^T C B with the law's tangent C and the strain's derivative B, plus the stress
    times the second derivative of the strain: convex without negative eigenvalues of both.
    """

    def __init__(self, mesh: Mesh, active: FaceMask, law: StrainLaw) -> None:
        faces = mesh.faces[active]
        self.dofs = (3 * faces[:, :, None] + np.arange(3)).reshape(-1, 9)
        self.areas = mesh.areas[active]
        self._law = law
        # (N, 3, 2), 1/m: the deformation gradient F (3, 2) is the sum of outer(corner, shape)
        a, b, c = (mesh.rest[faces[:, i]] for i in range(3))
        inverse = np.linalg.inv(np.stack([b - a, c - a], axis=-1))
        self._shape = np.concatenate([-inverse.sum(1, keepdims=True), inverse], axis=1)

    def _add_forces(self, q: StateVector, targets: np.ndarray, forces: np.ndarray) -> float:
        density, stress, _ = self._law.response(self.strains(q))
        _add_forces(q, self.dofs, self._shape, self.areas, stress, targets, forces)
        return float(self.areas @ density)

    def add_stiffness(
        self, q: StateVector, slots: np.ndarray, exact: np.ndarray, convex: np.ndarray
    ) -> None:
        _, stress, tangent = self._law.response(self.strains(q))
        terms = q, self.dofs, self._shape, self.areas, np.array(tangent), slots
        if len(exact):
            _add_stiffness(*terms, stress, False, exact)
        if len(convex):
            _add_stiffness(*terms, _tension(stress), True, convex)

    def strains(self, q: StateVector) -> np.ndarray:
        """(N, 3) Green strains E_uu, E_vv, 2 E_uv of the triangles."""
        return _strains(q, self.dofs, self._shape)

    def stretches(self, q: StateVector) -> np.ndarray:
        """(N, 2) principal stretches, the singular values of F, larger first."""
        return _principal(self.strains(q))[0]


class OfStretches:
    """A law of the Green strain by a ``law`` of the principal stretches: an isotropic material.

    With the principal Green strains E_i, the stretches are s_i = sqrt(1 + 2 E_i); with the
    derivatives p_i of the density by s_i, the principal stresses are p_i/s_i.
    """

    def __init__(self, law: StrainLaw) -> None:
        self._law = law

    def response(self, strain: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        s, turn = _principal(strain)
        density, p, pp = self._law.response(s - 1.0)
        return density, *_of_stretches(s, turn, p, pp)


def _tension(stress: np.ndarray) -> np.ndarray:
    """Stresses (N, 3) with the negative eigenvalues of their tensors set to zero."""
    mean, half = (stress[:, 0] + stress[:, 1]) / 2, (stress[:, 0] - stress[:, 1]) / 2
    radius = np.hypot(half, stress[:, 2])
    low, high = np.maximum(mean - radius, 0.0), np.maximum(mean + radius, 0.0)
    turn = (high - low) / np.where(radius > 0, 2 * radius, 1.0)
    mean = (high + low) / 2
    return np.column_stack([mean + turn * half, mean - turn * half, turn * stress[:, 2]])


@numba.njit(cache=True)
def _principal(strain):
    """Principal stretches (N, 2), larger first, and cosine and sine (N, 2) of twice the angle of
    its axis."""
    stretches, turn = np.empty((len(strain), 2)), np.empty((len(strain), 2))
    for t in range(len(strain)):
        total, across = strain[t, 0] + strain[t, 1], strain[t, 0] - strain[t, 1]
        shear = strain[t, 2]
        apart = np.hypot(across, shear)
        stretches[t, 0] = np.sqrt(max(1.0 + total + apart, 1e-24))
        stretches[t, 1] = np.sqrt(max(1.0 + total - apart, 1e-24))
        turn[t, 0] = across / apart if apart > 0.0 else 1.0
        turn[t, 1] = shear / apart if apart > 0.0 else 0.0
    return stretches, turn


@numba.njit(cache=True)
def _of_stretches(stretches, turn, p, pp):
    """Stresses (N, 3) and tangents (N, 3, 3) of a law with derivatives p (N, 2) and pp (N, 2, 2) by
    the stretches."""
    stress, tangent = np.empty((len(p), 3)), np.empty((len(p), 3, 3))
    axes = np.empty((3, 3))  # derivatives of principal strains and axis rotation by the strain
    for t in range(len(p)):
        cosine, sine = turn[t]
        a, b = stretches[t]
        mean, half = (p[t, 0] / a + p[t, 1] / b) / 2, (p[t, 0] / a - p[t, 1] / b) / 2
        stress[t, 0], stress[t, 1] = mean + half * cosine, mean - half * cosine
        stress[t, 2] = half * sine
        axes[0, 0], axes[0, 1], axes[0, 2] = (1.0 + cosine) / 2.0, (1.0 - cosine) / 2.0, sine / 2.0
        axes[1, 0], axes[1, 1], axes[1, 2] = (1.0 - cosine) / 2.0, (1.0 + cosine) / 2.0, -sine / 2.0
        axes[2, 0], axes[2, 1], axes[2, 2] = -sine / 2.0, sine / 2.0, cosine / 2.0
        apart = a - b
        slope = (p[t, 0] - p[t, 1]) / apart if apart > EQUAL else pp[t, 0, 0] - pp[t, 0, 1]
        first = (pp[t, 0, 0] - p[t, 0] / a) / (a * a)
        second = (pp[t, 1, 1] - p[t, 1] / b) / (b * b)
        mixed = pp[t, 0, 1] / (a * b)
        turning = 4.0 * (slope * b - p[t, 1]) / (a * b * (a + b))
        for i in range(3):
            for j in range(3):
                tangent[t, i, j] = (
                    first * axes[0, i] * axes[0, j] + second * axes[1, i] * axes[1, j]
                    + mixed * (axes[0, i] * axes[1, j] + axes[1, i] * axes[0, j])
                    + turning * axes[2, i] * axes[2, j]
                )
    return stress, tangent


@numba.njit(cache=True)
def _deformation(q, dofs, shape, f):
    """Fill f (3, 2) with the deformation gradient of one triangle."""
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
        result[t, 0], result[t, 1], result[t, 2] = 0.5 * (uu - 1.0), 0.5 * (vv - 1.0), uv
    return result


@numba.njit(cache=True)
def _strain_rows(q, dofs, shape, f, b):
    """Fill b (3, 9) with the derivatives of one triangle's strain; f (3, 2) is scratch memory."""
    _deformation(q, dofs, shape, f)
    for a in range(3):
        gu, gv = shape[a]
        for i in range(3):
            b[0, 3 * a + i] = f[i, 0] * gu
            b[1, 3 * a + i] = f[i, 1] * gv
            b[2, 3 * a + i] = f[i, 0] * gv + f[i, 1] * gu


@numba.njit(cache=True)
def _add_forces(q, dofs, shape, areas, stress, targets, forces):
    f, b = np.empty((3, 2)), np.empty((3, 9))
    for t in range(len(dofs)):
        _strain_rows(q, dofs[t], shape[t], f, b)
        for j in range(9):
            forces[targets[t, j]] += areas[t] * (
                stress[t, 0] * b[0, j] + stress[t, 1] * b[1, j] + stress[t, 2] * b[2, j])


@numba.njit(cache=True)
def _add_stiffness(q, dofs, shape, areas, tangent, slots, stress, convex, data):
    f, b, cb, block = np.empty((3, 2)), np.empty((3, 9)), np.empty((3, 9)), np.empty((9, 9))
    if convex:
        raise_eigenvalues(tangent, 0.0)
    for t in range(len(dofs)):
        _strain_rows(q, dofs[t], shape[t], f, b)
        for m in range(3):
            for j in range(9):
                cb[m, j] = areas[t] * (tangent[t, m, 0] * b[0, j] + tangent[t, m, 1] * b[1, j]
                                       + tangent[t, m, 2] * b[2, j])
        for i in range(9):
            for j in range(i, 9):
                block[i, j] = b[0, i] * cb[0, j] + b[1, i] * cb[1, j] + b[2, i] * cb[2, j]
        for a in range(3):
            wu = areas[t] * (stress[t, 0] * shape[t, a, 0] + stress[t, 2] * shape[t, a, 1])
            wv = areas[t] * (stress[t, 2] * shape[t, a, 0] + stress[t, 1] * shape[t, a, 1])
            for c in range(a, 3):
                h = wu * shape[t, c, 0] + wv * shape[t, c, 1]
                for i in range(3):
                    block[3 * a + i, 3 * c + i] += h
        add_block(data, slots[t], block)


@runtime_checkable
class Membrane(Protocol):
    """An in-plane material."""

    def energy(self, mesh: Mesh, active: FaceMask) -> Energy:
        """The energy of the active triangles of ``mesh``."""

    def scaled(self, factor: float) -> "Membrane":
        """A copy of the material, ``factor`` times as stiff."""


class LinearMembrane:
    """Stress linear in the strain."""

    @property
    @abstractmethod
    def matrix(self) -> np.ndarray:
        """Symmetric (K, K), N/m, from strain to stress."""

    def energy(self, mesh: Mesh, active: FaceMask) -> Energy:
        return StrainMembrane(mesh, active, self)

    def response(self, strain: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        stress = strain @ self.matrix
        density = 0.5 * np.einsum("ni,ni->n", strain, stress)
        return density, stress, np.broadcast_to(self.matrix, (len(strain), *self.matrix.shape))


@dataclass(frozen=True)
class Corotational(LinearMembrane):
    """Isotropic corotational membrane (section 4.1), the default.

    Its density mu |F - R|² + lambda/2 tr(R^T F - I)², R the isometry closest to the deformation
    gradient F, is mu (e1² + e2²) + lambda/2 (e1 + e2)² with e = s - 1, s the singular values of F.
    """

    stiffness: float = MEMBRANE_STIFFNESS  # Young's modulus times thickness, N/m
    poisson: float = 0.3

    def __post_init__(self) -> None:
        _check_positive(stiffness=self.stiffness)
        if not -1 < self.poisson < 1:
            raise InputError(f"poisson={self.poisson:g} must lie between -1 and 1")

    @property
    def mu(self) -> float:
        """Shear modulus times thickness, N/m."""
        return self.stiffness / (2 * (1 + self.poisson))

    @property
    def lam(self) -> float:
        """Lamé's first constant in the plane times thickness, N/m."""
        return self.stiffness * self.poisson / (1 - self.poisson**2)

    @cached_property
    def matrix(self) -> np.ndarray:
        return 2 * self.mu * np.eye(2) + self.lam

    def energy(self, mesh: Mesh, active: FaceMask) -> "StrainMembrane":
        return StrainMembrane(mesh, active, OfStretches(self))

    def scaled(self, factor: float) -> "Corotational":
        return replace(self, stiffness=factor * self.stiffness)


@dataclass(frozen=True)
class OrthotropicStVK(LinearMembrane):
    """Orthotropic St. Venant-Kirchhoff membrane (Larionov et al., Eq. 5 and 6).

    S_uu = (E_warp e_uu + n E_weft e_vv)/d, S_vv = (n E_weft e_uu + E_weft e_vv)/d,
    S_uv = shear 2 e_uv, with d = 1 - n² E_weft/E_warp. n is the contraction along weft over the
    extension along warp under tension along warp; under tension along weft it is n E_weft/E_warp.
    """

    warp: float = 200.0  # Young's modulus times thickness, N/m, as the next two
    weft: float = 200.0
    poisson: float = 0.3  # n
    shear: float = 200.0 / 2.6

    def __post_init__(self) -> None:
        _check_positive(warp=self.warp, weft=self.weft, shear=self.shear)
        limit = (self.warp / self.weft) ** 0.5
        if not abs(self.poisson) < limit:
            raise InputError(f"poisson={self.poisson:g} must stay below {limit:.3g} for these "
                             "warp and weft moduli")

    @cached_property
    def matrix(self) -> np.ndarray:
        d = 1 - self.poisson**2 * self.weft / self.warp
        coupling = self.poisson * self.weft / d
        return np.array([[self.warp / d, coupling, 0.0], [coupling, self.weft / d, 0.0],
                         [0.0, 0.0, self.shear]])

    def scaled(self, factor: float) -> "OrthotropicStVK":
        return replace(self, **{k: factor * getattr(self, k) for k in ("warp", "weft", "shear")})


def _check_positive(**values: float) -> None:
    for name, value in values.items():
        if not (np.isfinite(value) and value > 0):
            raise InputError(f"{name}={value:g} must be a positive number of N/m")
