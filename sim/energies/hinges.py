"""Hinge bending laws: every edge stores an energy of the angle between its two triangles.

They stand beside the default law for comparison and for export to simulators that use them. Their
moduli are not physical: the stiffness of a strip of hinges depends on its triangulation and does
not converge under refinement (docs/physics.md, :mod:`sim.cantilever.equivalent`).

An edge between held and free cloth clamps its free triangle. As in the default law it counts on
the free side alone: H is then the height of the free triangle, not the sum of two heights.
"""

import numpy as np

from sim.energies.base import Energy
from sim.energies.hinge_stencils import (
    HingeStencils,
    chain_gradient,
    chain_hessian,
    hinge_angles,
)
from sim.material import SOFTENING_LIMIT


class DihedralBending(Energy):
    """Energy e integral of tau(kappa) d theta of N hinges (Feng et al. 2022, Eq. 1 to 3).

    theta is the dihedral angle, e the edge's rest length, kappa = 2 |theta| / (H0 + H1) with the
    rest heights H of the two triangles, and tau the torque per width alpha kappa + beta kappa²,
    continued as :func:`sim.material.torque` is, so that it always grows.

    Args:
        hinges: the elements.
        alpha: (N,) linear moduli, N·m.
        beta: (N,) quadratic moduli, N·m².
    """

    def __init__(self, hinges: HingeStencils, *, alpha: np.ndarray, beta: np.ndarray) -> None:
        self.dofs = hinges.dofs
        self._alpha, self._beta = alpha, beta
        self._areas = bent_area(hinges)
        # kappa = spread * |theta|, 1/m per rad; e H / 2 is the area
        self._spread = hinges.lengths / self._areas

    def value(self, q: np.ndarray) -> float:
        return float(self._areas @ self._work(hinge_angles(q, self.dofs))[0])

    def gradient(self, q: np.ndarray) -> np.ndarray:
        angle = hinge_angles(q, self.dofs)
        _, torque, _ = self._work(angle)
        return chain_gradient(q, self.dofs, self._areas * self._spread * np.sign(angle) * torque)

    def hessian(self, q: np.ndarray, convex: bool = False) -> np.ndarray:
        # The torque always grows, so that only the turning of the hinges is indefinite.
        angle = hinge_angles(q, self.dofs)
        _, torque, tangent = self._work(angle)
        slope = self._areas * self._spread * np.sign(angle) * torque
        bend = self._areas * self._spread**2 * tangent
        return chain_hessian(q, self.dofs, 0.0 * slope if convex else slope, bend)

    def _work(self, angle: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return work_of_bending(self._spread * np.abs(angle), self._alpha, self._beta)


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
        self._scale = 1.5 * gamma / bent_area(hinges)
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


def bent_area(hinges: HingeStencils) -> np.ndarray:
    """(N,) m², rest area of the triangles of each hinge that can move, e (H0 + H1) / 2."""
    return (hinges.areas * hinges.movable).sum(axis=1)


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


def work_of_bending(
    curvature: np.ndarray, alpha: np.ndarray, beta: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Energy per area (J/m²), torque per width (N) and tangent (N·m).

    Of the law of :func:`sim.material.torque`, at ``curvature`` >= 0 (1/m) with moduli alpha
    (N·m) and beta (N·m²), all (N,).
    """
    u = -beta / alpha * curvature
    beyond = np.maximum(u - SOFTENING_LIMIT, 0.0)
    over = np.where(beyond > 0, u, 1.0)
    return (
        alpha * curvature**2 * (0.5 - u / 3 + beyond**3 / (3 * over**2)),
        alpha * curvature * (1 - u + beyond**2 / over),
        alpha * (1 - 2 * u + 2 * beyond),
    )
