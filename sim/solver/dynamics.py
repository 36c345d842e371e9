"""Motion of viscoelastic cloth: linearly implicit time steps.

Forces act at the positions that the cloth would reach after a relaxation time tau at its new
velocities v1: with the forces f, the masses M and a step of length h,

    M (v1 - v0) = h f(x0 + tau v1),    x1 = x0 + h v1.

For short steps this is M dv/dt = f(x) + tau df/dx v: all of the cloth's stiffness has a viscosity
(Kelvin and Voigt's), which damps a vibration of angular frequency w at the rate tau w²/2. For
h = tau it is backward Euler, damped by its step (Feng et al. 2022, section 4). The positions
u = x0 + tau v1 minimise E(u) + |u - y|²_M/(2 tau h), y = x0 + tau v0; one Newton step from x0, with
a line search, is taken towards them (Baraff and Witkin 1998, Large steps in cloth simulation). Its
Hessian is the exact one, or the convex one, as a viscosity must not feed an instability.
"""

import copy
from dataclasses import dataclass

import numpy as np

from common.types import Density, Points, StateVector
from sim.energies.base import Energy
from sim.mesh import Mesh
from sim.solver.linear import CholeskySolver
from sim.solver.newton import NewtonOptions, NewtonResult, minimise
from sim.solver.potential import Potential
from sim.solver.state import State

STEP_OPTIONS = NewtonOptions(residual=0.0, max_iterations=1, convexities=(0.0, 1.0), extend=False)


class Inertia(Energy):
    """|u - y|²_M / (2 tau h) of a time step; an element is a coordinate, ``masses`` (V,) in kg. At
    first y is zero and tau h is 1 s²; each step has its own (:meth:`aimed`)."""

    def __init__(self, mesh: Mesh, *, density: Density) -> None:
        self.masses = density * mesh.vertex_areas
        self.dofs = np.arange(3 * len(self.masses))[:, None]
        self._aim, self._scale = np.zeros(len(self.dofs)), np.repeat(self.masses, 3)

    def aimed(self, positions: Points, square: float) -> "Inertia":
        """That of a step with the positions y (V, 3), m, which the cloth would reach without
        forces, and tau h = ``square``, s²."""
        other = copy.copy(self)
        other._aim, other._scale = positions.ravel(), np.repeat(self.masses, 3) / square
        return other

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
        self, potential: Potential, inertia: Inertia, step: float, *, relaxation: float,
        solver: CholeskySolver | None = None
    ) -> tuple["Motion", NewtonResult]:
        """The motion after a ``step`` h, s, at most the ``relaxation`` time tau, s, and the outcome
        of its minimisation, whose state is the cloth's after tau; ``inertia`` is among the energies
        of ``potential``, and is aimed here. A ``solver`` for its pattern can be used again."""
        before = self.state.positions
        aimed = inertia.aimed(before + relaxation * self.velocities, step * relaxation)
        result = minimise(potential.exchanged({inertia: aimed}), self.state.q, STEP_OPTIONS,
                          solver=solver)
        after = State.of(result.q, len(before)).positions
        velocities = (after - before) / relaxation
        back = np.zeros(potential.unknowns)
        back[: before.size] = ((step - relaxation) * velocities).ravel()
        q = potential.moved(result.q, potential.free_unknowns(back))
        return Motion(State.of(q, len(before)), velocities, self.time + step), result
