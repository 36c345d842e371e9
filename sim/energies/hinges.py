"""Hinge bending: every edge stores an energy of the angle between its two triangles.

Hinges stand beside the default law for comparison and for export to simulators that use them. Their
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
from sim.energies.fold_barrier import barrier, is_bent, leaves_room
from sim.material import bending_work
from sim.mesh import Mesh


@dataclass(frozen=True, eq=False)
class HingeStencils:
    """N hinges with at least one triangle that can move, in the order of their edges.

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
        """(N, 12) unknowns, as :class:`sim.energies.base.Energy` asks for."""
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
    def bent_area(self) -> np.ndarray:
        """(N,) m², rest area of the triangles of each hinge that can move, e (H0 + H1) / 2."""
        return (self.areas * self.movable).sum(axis=1)


def find_hinges(mesh: Mesh, active: np.ndarray) -> HingeStencils:
    """Hinges of ``mesh`` beside the triangles ``active`` (F,) bool."""
    face, side = np.nonzero(active[:, None] & (mesh.neighbours >= 0))
    across = mesh.neighbours[face, side]
    # An edge between two active triangles appears twice; keep the first.
    edge, first = np.unique(mesh.face_edges[face, side], return_index=True)
    face, side, across = face[first], side[first], across[first]
    corner, take = mesh.faces[face], np.arange(len(face))
    start, end = corner[take, (side + 1) % 3], corner[take, (side + 2) % 3]
    corners = np.stack([start, end, corner[take, side], across], axis=1)
    pair = mesh.edge_faces[edge]
    both = np.stack([face, np.where(pair[:, 0] == face, pair[:, 1], pair[:, 0])], axis=1)
    origin = mesh.rest[start]
    return HingeStencils(
        edge=edge, corners=corners, areas=mesh.areas[both], movable=active[both],
        vectors=mesh.rest[end] - origin,
        opposite=mesh.rest[corners[:, 2:]] - origin[:, None],
    )


class DihedralBending(Energy):
    """Energy e integral of tau(kappa) d theta of N hinges (Feng et al. 2022, Eq. 1 to 3).

    theta is the dihedral angle, e the edge's rest length, kappa = 2 |theta| / (H0 + H1) with the
    rest heights H of the two triangles, and tau the torque per width alpha kappa + beta kappa²,
    continued as :func:`sim.material.bending_work` does, so that it always grows. A barrier
    (:mod:`sim.energies.fold_barrier`) of the ``stiffness`` keeps triangles from folding through
    each other.

    Args:
        hinges: the elements.
        alpha, beta: (N,) moduli, N·m and N·m².
        stiffness: of the barrier, N·m.
    """

    def __init__(
        self, hinges: HingeStencils, *, alpha: np.ndarray, beta: np.ndarray, stiffness: float
    ) -> None:
        self.dofs = hinges.dofs
        self._alpha, self._beta, self._areas = alpha, beta, hinges.bent_area
        # kappa = spread * |theta|, 1/m per rad; e H / 2 is the area
        self._spread = hinges.lengths / self._areas
        self._barrier = stiffness * hinges.lengths**2 / hinges.areas.sum(axis=1)

    def value(self, q: np.ndarray) -> float:
        return float(self._work(q)[0].sum())

    def gradient(self, q: np.ndarray) -> np.ndarray:
        return chain_gradient(q, self.dofs, self._work(q)[1])

    def hessian(self, q: np.ndarray, convex: bool = False) -> np.ndarray:
        # The torque always grows, so that only the turning of the hinges is indefinite.
        _, slope, bend = self._work(q)
        return chain_hessian(q, self.dofs, 0.0 * slope if convex else slope, bend)

    def allows(self, old: np.ndarray, new: np.ndarray) -> bool:
        return leaves_room(hinge_angles(old, self.dofs), hinge_angles(new, self.dofs), np.pi)

    def _work(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Energies (N,), J, and their first two derivatives by the angles."""
        angle = hinge_angles(q, self.dofs)
        density, torque, tangent = bending_work(
            self._spread * np.abs(angle), self._alpha, self._beta)
        value = self._areas * density
        slope = self._areas * self._spread * np.sign(angle) * torque
        bend = self._areas * self._spread**2 * tangent
        bent = is_bent(angle, np.pi)
        if bent.any():
            for total, part in zip((value, slope, bend), barrier(angle[bent], np.pi), strict=True):
                total[bent] += self._barrier[bent] * part
        return value, slope, bend


class QuadraticBending(Energy):
    """Energy 3 gamma / ((H0 + H1) e) |K x|² of N hinges (Bergou et al. 2006; Feng et al., Eq. 4).

    x are a hinge's four corners, e and H as in :class:`DihedralBending`. The weights K vanish on
    every flat, undistorted hinge, and a hinge folded by theta has |K x| = 2 e sin(theta/2): for
    small angles this is the linear dihedral law with alpha = 3 gamma. The Hessian is constant.

    Args:
        hinges: the elements.
        gamma: (N,) moduli, N·m.
    """

    def __init__(self, hinges: HingeStencils, *, gamma: np.ndarray) -> None:
        self.dofs = hinges.dofs
        self._weights = flatness_weights(hinges)
        self._scale = 1.5 * gamma / hinges.bent_area
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


def flatness_weights(hinges: HingeStencils) -> np.ndarray:
    """(N, 4) weights K of the corners: e times the unit heights of both triangles, added up."""
    squared = hinges.lengths**2
    weights = np.zeros((len(squared), 4))
    for side in range(2):
        # foot of the height on the edge, as a fraction from its start, and e over the height
        foot = (hinges.opposite[:, side] * hinges.vectors).sum(axis=1) / squared
        ratio = squared / (2 * hinges.areas[:, side])
        weights[:, 0] += ratio * (1 - foot)
        weights[:, 1] += ratio * foot
        weights[:, 2 + side] = -ratio
    return weights


@numba.njit(cache=True)
def hinge_angles(q, dofs):
    """(N,) dihedral angles, rad, of hinges with unknowns ``dofs`` (N, 12) of ``q``."""
    x, result = np.empty((4, 3)), np.empty(len(dofs))
    for t in range(len(dofs)):
        _load(q, dofs[t], x)
        result[t] = dihedral.angle(x)
    return result


@numba.njit(cache=True)
def chain_gradient(q, dofs, slope):
    """(N, 12) gradients of energies E(theta) with the derivatives ``slope`` (N,), J/rad."""
    result = np.zeros((len(dofs), 12))
    x, g = np.empty((4, 3)), np.empty((4, 3))
    for t in range(len(dofs)):
        _load(q, dofs[t], x)
        dihedral.gradient(x, g)
        for k in range(12):
            result[t, k] = slope[t] * g[k // 3, k % 3]
    return result


@numba.njit(cache=True)
def chain_hessian(q, dofs, slope, bend):
    """(N, 12, 12) Hessians of energies E(theta) with derivatives ``slope`` and ``bend`` (N,).

    The part of ``slope`` is indefinite, that of ``bend`` has the sign of ``bend``.
    """
    result = np.zeros((len(dofs), 12, 12))
    x, g, frame = np.empty((4, 3)), np.empty((4, 3)), np.empty((3, 3))
    for t in range(len(dofs)):
        _load(q, dofs[t], x)
        dihedral.gradient(x, g)
        for a in range(12):
            for b in range(12):
                result[t, a, b] = bend[t] * g[a // 3, a % 3] * g[b // 3, b % 3]
        dihedral.add_hessian(x, slope[t], (0, 3, 6, 9), frame, result[t])
    return result


@numba.njit(inline="always")
def _load(q, dofs, x):
    """Copy the corners of one hinge to x (4, 3)."""
    for k in range(12):
        x[k // 3, k % 3] = q[dofs[k]]
