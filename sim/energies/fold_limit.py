"""Keeps hinges from folding through themselves, where meshes are too coarse for the cloth."""

import numpy as np

from sim.energies.hinge_stencils import chain_gradient, chain_hessian, find_hinges, hinge_angles
from sim.energies.remember import Remembered
from sim.mesh import Mesh

LIMIT_START = 2.4  # rad; the angle at which the resistance begins
LEAST_ROOM = 0.2  # share of the way to pi that a step must leave


class FoldLimit:
    """Barrier k e/h (-(|theta| - s)² log((pi - |theta|)/(pi - s))) on hinges folded beyond s.

    theta is the dihedral angle, s = ``LIMIT_START``, e/h the edge's length over the mean height
    of its triangles. The barrier is smooth, zero up to s and infinite at pi, where two triangles
    would lie on each other and the angle would jump by 2 pi. A converged drape that feels it is
    not resolved by its mesh.

    Args:
        mesh: the specimen.
        active: (F,) bool, triangles that can move.
        stiffness: k, N·m.

    Attributes:
        scale: (N,) k e/h, J.
    """

    def __init__(self, mesh: Mesh, active: np.ndarray, *, stiffness: float) -> None:
        hinges = find_hinges(mesh, active)
        self.dofs = hinges.dofs
        self._angles = Remembered()
        self.scale = stiffness * (hinges.vectors**2).sum(axis=1) / hinges.areas.sum(axis=1)

    def angles(self, q: np.ndarray) -> np.ndarray:
        """(N,) dihedral angles, rad."""
        return self._angles.at(q, lambda q: hinge_angles(q, self.dofs))

    def value(self, q: np.ndarray) -> float:
        angle = np.abs(self.angles(q))
        bent = angle > LIMIT_START
        return float(self.scale[bent] @ barrier(angle[bent])[0])

    def gradient(self, q: np.ndarray) -> np.ndarray:
        return chain_gradient(q, self.dofs, self._derivatives(q)[0])

    def is_felt(self, q: np.ndarray) -> bool:
        return bool((np.abs(self.angles(q)) > LIMIT_START).any())

    def hessian(self, q: np.ndarray, convexity: float) -> np.ndarray | None:
        if not self.is_felt(q):
            return None
        slope, bend = self._derivatives(q)
        return chain_hessian(q, self.dofs, slope * (1.0 - convexity), bend)

    def allows(self, old: np.ndarray, new: np.ndarray) -> bool:
        """False when a hinge would jump past pi or take most of its way there in one step.

        The second is the fraction-to-boundary rule of interior-point methods: without it, a
        step can end so close to pi that no later one gets away.
        """
        before, after = self.angles(old), self.angles(new)
        room = np.minimum(np.pi - np.abs(before), np.pi - LIMIT_START)
        enough = np.pi - np.abs(after) >= LEAST_ROOM * room
        return bool(((np.abs(after - before) < np.pi) & enough).all())

    def _derivatives(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """First and second derivatives (N,) of each element's energy by its angle."""
        angle = self.angles(q)
        bent = np.flatnonzero(np.abs(angle) > LIMIT_START)
        first, second = np.zeros(len(angle)), np.zeros(len(angle))
        _, slope, bend = barrier(np.abs(angle[bent]))
        first[bent] = slope * (self.scale[bent] * np.sign(angle[bent]))
        second[bent] = bend * self.scale[bent]
        return first, second


def barrier(angle: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Barrier per unit of scale and its first two derivatives at angles >= LIMIT_START."""
    over = angle - LIMIT_START
    left = np.pi - angle
    logarithm = np.log(left / (np.pi - LIMIT_START))
    return (
        -(over**2) * logarithm,
        over**2 / left - 2.0 * over * logarithm,
        4.0 * over / left + over**2 / left**2 - 2.0 * logarithm,
    )
