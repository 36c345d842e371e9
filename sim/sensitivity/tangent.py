"""An equilibrium with the factor of its exact Hessian."""

from dataclasses import replace

import numpy as np

from common.arguments import require
from common.errors import InputError
from common.types import Points, StateVector
from sim.cloth import Cloth
from sim.energies.self_contact import SelfContact, contact_near
from sim.equilibrium import Equilibrium
from sim.solver.linear import CholeskySolver, make_solver

MAX_STEP, MAX_RESIDUAL = 1e-5, 1e-6
"""Next Newton step, mm, and largest force, weights of a vertex, of a state that is differentiated.
Residual forces add a stiffness of about this magnitude per mm to free motions."""
MAX_FIRST_STEP = 0.1
"""Newton step, mm, from which on a state does not count as an equilibrium."""
MIN_STIFFNESS = 1e-7
"""Stiffness of the softest mode, in units of a vertex's weight per mm, below which the Hessian
counts as singular. Drapes have about 1e-2, a free motion has 1e-12 by rounding."""
_MAX_STEPS = 4
_INVERSE_ITERATIONS = 2  # a rough estimate of the lowest stiffness is sufficient


class Tangent:
    """Linearisation of a cloth at an equilibrium: its response to forces.

    The state, at or near an equilibrium, is first improved by a few exact Newton steps, until they
    are below :data:`MAX_STEP`; ``factor`` is that of the exact Hessian there, if it exists.

    Attributes:
        q: state at the equilibrium.
        ok, message: whether it is a minimum with a regular Hessian; the reason if not.
        softest: estimated stiffness of the softest mode (:data:`MIN_STIFFNESS`); 0 without factor.
    """

    def __init__(self, cloth: Cloth, q: StateVector, factor: CholeskySolver | None = None) -> None:
        self.cloth, self.q = cloth, q
        self.softest = 0.0
        self._factor = factor or make_solver(cloth.potential.pattern)
        self.ok, self.message = self._approach(outdated=factor is None)

    @classmethod
    def of(cls, drape: Equilibrium) -> "Tangent":
        """The tangent of a drape; not ok if the drape did not converge."""
        require(drape=(drape, Equilibrium))
        cloth, factor = drape.cloth, drape.outcome.factor if drape.outcome else None
        if drape.touches and factor is None:
            contact = contact_near(cloth.scene, drape.positions)
            cloth = replace(cloth, extra=[*cloth.extra, contact])
        tangent, reason = cls(cloth, drape.state.q, factor), ""
        contact = [e for e in tangent.cloth.extra if isinstance(e, SelfContact)]
        if not drape.converged:
            reason = f"the drape is no equilibrium: {drape.message}"
        elif not all(energy.is_complete(tangent.q) for energy in contact):
            reason = "self-contact reaches further than the Hessian's pattern"
        if reason:
            tangent.ok, tangent.message, tangent.softest = False, reason, 0.0
        return tangent

    @property
    def positions(self) -> Points:
        """Positions at the equilibrium."""
        return self.q[: self.coordinates].reshape(-1, 3)

    @property
    def coordinates(self) -> int:
        """Number of unknowns that are coordinates; the others are rotations."""
        return 3 * len(self.cloth.scene.mesh.rest)

    def response(self, force: np.ndarray) -> np.ndarray:
        """Moves H⁻¹ f (U,) under a ``force`` f (U,), N; NaN if the tangent is not ok. U unknowns
        are the 3 V coordinates of vertices, then the turn of each of E edges."""
        expected = self.coordinates + len(self.cloth.scene.mesh.edges)
        if np.shape(force) != (expected,):
            raise InputError(f"force has the shape {np.shape(force)}; it must have ({expected},): "
                             "3 V coordinates and E turns of edges")
        if not self.ok:
            return np.full(len(force), np.nan)
        potential = self.cloth.potential
        return potential.all_unknowns(self._factor.solve(potential.free_unknowns(force)))

    def _approach(self, *, outdated: bool) -> tuple[bool, str]:
        """Take the last Newton steps and factorise; returns ``ok`` and ``message``. The factor is
        ``outdated`` if it is not that of the state."""
        potential = self.cloth.potential
        for _ in range(_MAX_STEPS):
            if outdated:
                data = potential.model(self.q).hessian()
                if not self._factor.factorise(data):
                    return False, "the Hessian is not positive definite: no minimum, or a fold"
            gradient = potential.gradient(self.q)
            step = self._factor.solve(-gradient)
            length = potential.step_length(step)
            if not length < MAX_FIRST_STEP:
                break
            if length < MAX_STEP and potential.residual(gradient) < MAX_RESIDUAL:
                self.softest = self._softest()
                if self.softest < MIN_STIFFNESS:
                    return False, "the Hessian is singular: the cloth can move freely, or a fold"
                return True, "equilibrium"
            self.q = potential.moved(self.q, step)
            outdated = True
        return False, f"no equilibrium: Newton's method goes on by {length:.1e} mm"

    def _softest(self) -> float:
        potential = self.cloth.potential
        scale = potential.regularisation
        motion = np.random.default_rng(0).standard_normal(potential.size)
        for _ in range(_INVERSE_ITERATIONS):
            motion /= np.sqrt(scale @ motion**2)
            before, motion = motion, self._factor.solve(scale * motion)
        return float(1.0 / (before @ (scale * motion)))
