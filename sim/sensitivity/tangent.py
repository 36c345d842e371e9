"""An equilibrium with the factor of its exact Hessian."""

import numpy as np

from sim.cloth import Cloth
from sim.drape import DrapeResult
from sim.energies.self_contact import SelfContact
from sim.equilibrium import Equilibrium
from sim.linear import CholeskySolver, make_solver
from sim.potential import hessian_product
from sim.self_contact import contact_near

STEP, RESIDUAL = 1e-5, 1e-6
"""mm and weights of a vertex: Newton's next step and largest force at the state that is
differentiated. Forces that are left make free motions look stiff, by about as much per mm."""
FARTHEST = 0.1
"""mm: length of the first step from which a state does not count as an equilibrium."""
SOFTEST = 1e-7
"""Stiffness of the softest motion, in units of a vertex's weight per mm, below which the Hessian
counts as singular. Drapes have some 1e-2, a free motion has 1e-12 by rounding."""
_STEPS = 4
_POWERS = 2  # inverse iterations: the softest motion of a regular Hessian is only of interest


class Tangent:
    """The equilibrium of a cloth at a state, and the linear response to forces on it.

    The state of ``found``, an equilibrium or next to one, is first moved by a few exact Newton
    steps, until :data:`STEP` is kept.

    Attributes:
        cloth, q: its energies, and the state (3 V + 3 E,) at the equilibrium.
        ok, message: whether it is a minimum with a regular Hessian, without which there is no
            response; why not.
        softest: about the stiffness of the softest motion, see :data:`SOFTEST`; 0 without a factor.
    """

    def __init__(self, found: Equilibrium) -> None:
        self.cloth, self.q = found.cloth, found.state.q
        self.softest = 0.0
        self._factor: CholeskySolver | None = found.newton.factor
        self.ok, self.message = self._approach()

    @classmethod
    def of(cls, result: DrapeResult) -> "Tangent":
        """The tangent of a drape, of the fabric at the reference density; not ok where it did not
        converge."""
        found = result.equilibrium
        if found is None:
            extra = [*result.extra, *([possible_contact(result)] if result.touches else [])]
            cloth = Cloth(result.scene, result.simulated, laws=result.laws, extra=extra)
            found = Equilibrium.at(cloth, result.state)
        tangent, reason = cls(found), ""
        contact = [e for e in tangent.cloth.extra if isinstance(e, SelfContact)]
        if not result.converged:
            reason = f"the drape is no equilibrium: {result.message}"
        elif not all(energy.is_complete(tangent.q) for energy in contact):
            reason = "self-contact reaches further than the Hessian's pattern"
        if reason:
            tangent.ok, tangent.message, tangent.softest = False, reason, 0.0
        return tangent

    @property
    def positions(self) -> np.ndarray:
        """(V, 3) m."""
        return self.q[: self.coordinates].reshape(-1, 3)

    @property
    def coordinates(self) -> int:
        """How many of the unknowns are coordinates; the others are rotations."""
        return 3 * len(self.cloth.scene.mesh.rest)

    def response(self, force: np.ndarray) -> np.ndarray:
        """(U,) moves H⁻¹ f under a force (U,), N, zero where the cloth is held; what acts there has
        no effect. NaN where the tangent is not ok."""
        if not self.ok:
            return np.full(len(force), np.nan)
        potential = self.cloth.potential
        return potential.all_unknowns(self._factor.solve(potential.free_unknowns(force)))

    def force_of(self, move: np.ndarray) -> np.ndarray:
        """(U,) change of the energy's gradient when the unknowns move by ``move`` (U,)."""
        return hessian_product(self.cloth.potential.energies, self.q, move)

    def _approach(self) -> tuple[bool, str]:
        """Take the last Newton steps and factorise; ``ok`` and ``message``."""
        potential, fresh = self.cloth.potential, self._factor is None
        for _ in range(_STEPS):
            if fresh:
                data = potential.hessian(self.q)
                self._factor = self._factor or make_solver(potential.pattern)
                if not self._factor.factorise(data):
                    return False, "the Hessian is not positive definite: no minimum, or a fold"
            gradient = potential.gradient(self.q)
            step = self._factor.solve(-gradient)
            length = potential.step_length(step)
            if not length < FARTHEST:
                break
            if length < STEP and potential.residual(gradient) < RESIDUAL:
                self.softest = self._softest()
                if self.softest < SOFTEST:
                    return False, "the Hessian is singular: the cloth can move freely, or a fold"
                return True, "equilibrium"
            self.q = potential.moved(self.q, step)
            fresh = True
        return False, f"no equilibrium: Newton's method goes on by {length:.1e} mm"

    def _softest(self) -> float:
        potential = self.cloth.potential
        scale = potential.regularisation
        motion = np.random.default_rng(0).standard_normal(potential.size)
        for _ in range(_POWERS):
            motion /= np.sqrt(scale @ motion**2)
            before, motion = motion, self._factor.solve(scale * motion)
        return float(1.0 / (before @ (scale * motion)))


def possible_contact(result: DrapeResult) -> SelfContact:
    """The contact of a drape with itself, as its search would add it; zero for most drapes."""
    return contact_near(result.scene, result.positions, density=result.simulated.density)
