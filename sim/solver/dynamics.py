"""Motion of cloth: implicit time steps, each a minimisation (Feng et al. 2022, section 4).

Backward Euler: the state at the end of a step of length h minimises E(x) + |x - y|²_M / (2 h²) over
the energies E of the cloth, with y = x0 + h v0 of the positions x0 and velocities v0 before the
step and the masses M of the vertices. Motions faster than a step are damped.
"""

from dataclasses import dataclass

import numpy as np

from common.types import Density, Points, StateVector
from sim.energies.base import Energy
from sim.mesh import Mesh
from sim.solver.linear import CholeskySolver
from sim.solver.newton import NewtonOptions, NewtonResult, minimise
from sim.solver.potential import Potential
from sim.solver.state import State

STEP_OPTIONS = NewtonOptions(residual=0.1, step=2.0, max_iterations=40)
"""Stopping criteria of a time step, whose own error is larger."""


class Inertia(Energy):
    """|x - y|²_M / (2 h²) of a time step; an element is a coordinate, ``masses`` (V,) are in kg."""

    def __init__(self, mesh: Mesh, *, density: Density) -> None:
        self.masses = density * mesh.vertex_areas
        self.dofs = np.arange(3 * len(self.masses))[:, None]
        self.aim(np.zeros((len(self.masses), 3)), 1.0)

    def aim(self, positions: Points, step: float) -> None:
        """Set the positions y that the cloth would reach without forces after a ``step`` h, s."""
        self._aim, self._scale = positions.ravel(), np.repeat(self.masses, 3) / step**2

    def value(self, q: StateVector) -> float:
        return 0.5 * float(self._scale @ (q[: len(self._aim)] - self._aim) ** 2)

    def gradient(self, q: StateVector) -> np.ndarray:
        return (self._scale * (q[: len(self._aim)] - self._aim))[:, None]

    def hessian(self, q: StateVector, convex: bool = False) -> np.ndarray:
        return self._scale[:, None, None]


@dataclass(eq=False)
class Motion:
    """Cloth in motion."""

    state: State
    velocities: np.ndarray  # (V, 3) m/s
    time: float = 0.0  # s

    @staticmethod
    def at_rest(state: State) -> "Motion":
        """Cloth without velocity."""
        return Motion(state, np.zeros_like(state.positions))

    def advanced(
        self, potential: Potential, inertia: Inertia, step: float, *,
        options: NewtonOptions = STEP_OPTIONS, solver: CholeskySolver | None = None
    ) -> tuple["Motion", NewtonResult]:
        """The motion after a ``step``, s, and the outcome of its minimisation; ``inertia`` is among
        the energies of ``potential``. A ``solver`` for its pattern can be used again."""
        before = self.state.positions
        inertia.aim(before + step * self.velocities, step)
        result = minimise(potential, self._guess(potential, step), options, solver=solver)
        state = State.of(result.q, len(before))
        velocities = (state.positions - before) / step
        return Motion(state, velocities, self.time + step), result

    def _guess(self, potential: Potential, step: float) -> np.ndarray:
        """The state after a ``step``, s, at constant velocities if it has the lower energy; else
        the present one."""
        q = self.state.q
        move = np.zeros(potential.unknowns)
        move[: self.velocities.size] = step * self.velocities.ravel()
        ahead = potential.moved(q, potential.free_unknowns(move))
        with np.errstate(all="ignore"):
            better = potential.value(ahead) < potential.value(q)
        return ahead if better and potential.allows(q, ahead) else q
