"""Energies of hinges: every edge stores an energy of the angle between its two triangles.

They stand beside the default law for comparison and for export to simulators that use them. Their
moduli are not physical: the stiffness of a strip of hinges depends on its triangulation and does
not converge under refinement (docs/physics.md, :mod:`sim.cantilever.equivalent`).

An edge between held and free cloth clamps its free triangle. As in the default law it counts on
the free side alone: H is then the height of the free triangle, not the sum of two heights.
"""

from dataclasses import dataclass

import numba
import numpy as np

from sim.energies import dihedral
from sim.energies.base import Energy
from sim.energies.fold_barrier import barrier, stays_clear
from sim.material import bending_work
from sim.mesh import Mesh


@dataclass(frozen=True, eq=False)
class Hinges:
    """N edges between two triangles of which one at least can move, in the mesh's order.

    Attributes:
        edge: (N,) the mesh's edges they fold about.
        corners: (N, 4) vertices in the order of :mod:`sim.energies.dihedral`: the edge's ends,
            then the corners opposite it. The first triangle can move.
        areas: (N, 2) m², rest areas of the two triangles.
        movable: (N, 2) bool, which of the two triangles can move; column 0 is all true.
        vectors: (N, 2) m, the rest edges from their start.
        opposite: (N, 2, 2) m, the two corners opposite the edge, from its start.
    """

    edge: np.ndarray
    corners: np.ndarray
    areas: np.ndarray
    movable: np.ndarray
    vectors: np.ndarray
    opposite: np.ndarray

    @property
    def dofs(self) -> np.ndarray:
        """(N, 12) entries of the unknowns, as :class:`sim.energies.base.Energy` asks for."""
        return (3 * self.corners[:, :, None] + np.arange(3)).reshape(-1, 12)

    @property
    def lengths(self) -> np.ndarray:
        """(N,) m, rest lengths of the edges."""
        return np.linalg.norm(self.vectors, axis=1)

    @property
    def normals(self) -> np.ndarray:
        """(N, 2) unit vectors across the rest edges, in material axes."""
        return np.stack([self.vectors[:, 1], -self.vectors[:, 0]], axis=1) / self.lengths[:, None]

    @property
    def bent_areas(self) -> np.ndarray:
        """(N,) m², rest area of the triangles of each hinge that can move, e (H0 + H1) / 2."""
        return (self.areas * self.movable).sum(axis=1)


def find_hinges(mesh: Mesh, active: np.ndarray) -> Hinges:
    """Hinges of ``mesh`` beside the triangles ``active`` (F,) bool."""
    pair = mesh.edge_faces
    edge = np.flatnonzero((pair[:, 1] >= 0) & active[pair].any(axis=1))
    pair = np.where(active[pair[edge, :1]], pair[edge], pair[edge, ::-1])
    # The first triangle's corners in their order, from the one opposite the edge
    side = (mesh.face_edges[pair[:, 0]] == edge[:, None]).argmax(axis=1)
    opposite, start, end = mesh.faces[pair[:, :1], (side[:, None] + np.arange(3)) % 3].T
    across = mesh.faces[pair[:, 1]].sum(axis=1) - start - end
    corners = np.stack([start, end, opposite, across], axis=1)
    from_start = mesh.rest[corners[:, 1:]] - mesh.rest[start][:, None]
    return Hinges(edge, corners, mesh.areas[pair], active[pair], from_start[:, 0],
                  from_start[:, 1:])


class DihedralBending(Energy):
    """Energy e integral of tau(kappa) d theta of N hinges (Feng et al. 2022, Eq. 1 to 3).

    theta is the dihedral angle, e the edge's rest length, kappa = 2 |theta| / (H0 + H1) with the
    rest heights H of the two triangles, and tau the torque of :func:`sim.material.bending_work`,
    which always grows. The barrier of :mod:`sim.energies.fold_barrier` acts on theta, times
    ``stop`` and e²/(A0 + A1) with the rest areas A of both triangles.

    Args:
        hinges: the elements.
        alpha: (N,) linear moduli, N·m.
        beta: (N,) quadratic moduli, N·m².
        stop: modulus of the barrier, N·m.
    """

    def __init__(
        self, hinges: Hinges, *, alpha: np.ndarray, beta: np.ndarray, stop: float
    ) -> None:
        self.dofs = hinges.dofs
        self._alpha, self._beta = alpha, beta
        self._areas, self._lengths = hinges.bent_areas, hinges.lengths
        # kappa = spread * |theta|, 1/m per rad; e H / 2 is the area
        self._spread = self._lengths / self._areas
        self._stop = stop * self._lengths**2 / hinges.areas.sum(axis=1)

    def value(self, q: np.ndarray) -> float:
        angle = hinge_angles(q, self.dofs)
        return float(self._areas @ self._work(angle)[0] + self._stop @ barrier(angle, np.pi)[0])

    def gradient(self, q: np.ndarray) -> np.ndarray:
        return _chain_gradient(q, self.dofs, self._derivatives(q)[0])

    def hessian(self, q: np.ndarray, convex: bool = False) -> np.ndarray:
        # Torque and barrier always grow, so that only the turning of the hinges is indefinite.
        slope, bend = self._derivatives(q)
        return _chain_hessian(q, self.dofs, 0.0 * slope if convex else slope, bend)

    def allows(self, old: np.ndarray, new: np.ndarray) -> bool:
        """False when a hinge would fold through itself, or take most of its way there."""
        return stays_clear(hinge_angles(old, self.dofs), hinge_angles(new, self.dofs), np.pi)

    def _work(self, angle: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return bending_work(self._spread * np.abs(angle), self._alpha, self._beta)

    def _derivatives(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """First (N,) and second (N,) derivatives of each hinge's energy by its angle, J."""
        angle = hinge_angles(q, self.dofs)
        _, torque, tangent = self._work(angle)
        _, slope, bend = barrier(angle, np.pi)
        return (self._lengths * np.sign(angle) * torque + self._stop * slope,
                self._lengths * self._spread * tangent + self._stop * bend)


class QuadraticBending(Energy):
    """Energy 3 gamma / ((H0 + H1) e) |K x|² of N hinges (Bergou et al. 2006; Feng et al., Eq. 4).

    x are a hinge's four corners, e and H as in :class:`DihedralBending`. The weights K vanish on
    every flat, undistorted hinge, and a hinge folded by theta has |K x| = 2 e sin(theta/2): for
    small angles this is the linear dihedral law with alpha = 3 gamma. The Hessian is constant.

    Args:
        hinges: the elements.
        gamma: (N,) moduli, N·m.
    """

    def __init__(self, hinges: Hinges, *, gamma: np.ndarray) -> None:
        self.dofs = hinges.dofs
        self._weights = _flatness_weights(hinges)
        self._scale = 1.5 * gamma / hinges.bent_areas
        blocks = np.einsum("n,ni,nj,ab->niajb", 2 * self._scale, self._weights, self._weights,
                           np.eye(3))
        self._hessian = blocks.reshape(-1, 12, 12)

    def value(self, q: np.ndarray) -> float:
        return float(self._scale @ (self._folds(q) ** 2).sum(axis=1))

    def gradient(self, q: np.ndarray) -> np.ndarray:
        force = 2 * self._scale[:, None] * self._folds(q)
        return (self._weights[:, :, None] * force[:, None, :]).reshape(-1, 12)

    def hessian(self, q: np.ndarray, convex: bool = False) -> np.ndarray:
        return self._hessian

    def _folds(self, q: np.ndarray) -> np.ndarray:
        """(N, 3) K x, m."""
        return np.einsum("ni,nik->nk", self._weights, q[self.dofs].reshape(-1, 4, 3))


def _flatness_weights(hinges: Hinges) -> np.ndarray:
    """(N, 4) weights K of the corners: e times the unit heights of both triangles, added up."""
    squared = (hinges.lengths**2)[:, None]
    # foot of the height on the edge, as a fraction from its start, and e over the height
    foot = np.einsum("nsk,nk->ns", hinges.opposite, hinges.vectors) / squared
    ratio = squared / (2 * hinges.areas)
    ends = np.stack([(ratio * (1 - foot)).sum(axis=1), (ratio * foot).sum(axis=1)], axis=1)
    return np.hstack([ends, -ratio])


@numba.njit(cache=True)
def hinge_angles(q, dofs):
    """(N,) dihedral angles, rad, of hinges with unknowns ``dofs`` (N, 12) of ``q``."""
    x = np.empty((4, 3))
    result = np.empty(len(dofs))
    for t in range(len(dofs)):
        _load(q, dofs[t], x)
        result[t] = dihedral.angle(x)
    return result


@numba.njit(cache=True)
def _chain_gradient(q, dofs, slope):
    """(N, 12) gradients of energies E(theta) with the derivatives ``slope`` (N,), J/rad."""
    result = np.empty((len(dofs), 12))
    x, g = np.empty((4, 3)), np.empty((4, 3))
    for t in range(len(dofs)):
        _load(q, dofs[t], x)
        _angle_gradient(x, g)
        for k in range(12):
            result[t, k] = slope[t] * g[k // 3, k % 3]
    return result


@numba.njit(cache=True)
def _chain_hessian(q, dofs, slope, bend):
    """(N, 12, 12) Hessians of energies E(theta) with derivatives ``slope`` and ``bend`` (N,).

    The part of ``slope`` is indefinite, that of ``bend`` has the sign of ``bend``.
    """
    result = np.empty((len(dofs), 12, 12))
    x, g, frame = np.empty((4, 3)), np.empty((4, 3)), np.empty((3, 3))
    for t in range(len(dofs)):
        _load(q, dofs[t], x)
        _angle_gradient(x, g)
        for a in range(12):
            for b in range(12):
                result[t, a, b] = bend[t] * g[a // 3, a % 3] * g[b // 3, b % 3]
        if slope[t] != 0.0:
            for corner, sign in ((2, 1.0), (3, -1.0)):
                dihedral.add_side_hessian(x, corner, sign, slope[t], (0, 3, 6, 9), frame,
                                          result[t])
    return result


@numba.njit(inline="always")
def _load(q, dofs, x):
    """Copy the corners of one hinge to x (4, 3)."""
    for k in range(12):
        x[k // 3, k % 3] = q[dofs[k]]


@numba.njit(inline="always")
def _angle_gradient(x, g):
    """Fill g (4, 3) with the derivatives of the angle by the corners x (4, 3)."""
    g[:, :] = 0.0
    dihedral.add_side_gradient(x, 2, 1.0, g)
    dihedral.add_side_gradient(x, 3, -1.0, g)
