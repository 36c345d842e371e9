"""An equilibrium with the factor of its exact Hessian."""

from collections.abc import Sequence

import numpy as np

from common.errors import InputError
from sim.drape import DrapeResult
from sim.energies.base import Energy
from sim.energies.self_contact import SelfContact
from sim.equilibrium import build_potential, cloth_terms
from sim.hinge_laws import HingeLaw
from sim.laws import Laws
from sim.linear import SparsePattern, make_solver
from sim.material import REFERENCE_DENSITY, Fabric
from sim.mesh import Mesh
from sim.potential import Potential
from sim.scene import Scene, State
from sim.self_contact import contact_near
from sim.sensitivity.parameters import force_derivatives, forces, hessian_product

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
_BALANCED = 1e-2  # of a vertex's weight: a drape without contact has 1e-4 at most


class Tangent:
    """The equilibrium of a cloth at a state, and the linear response to forces on it.

    The state is first moved by a few exact Newton steps, until :data:`STEP` is kept.

    Args:
        scene, fabric, state, laws, extra: as for :func:`sim.equilibrium.build_potential`.

    Attributes:
        scene, fabric, laws: as given.
        q: (Q,) unknowns at the equilibrium, positions and rotations.
        ok: whether it is a minimum with a regular Hessian; without, there is no response.
        message: how it ended.
        softest: about the stiffness of the softest motion, see :data:`SOFTEST`; 0 where there is no
            factor.

    Raises:
        InputError: a law that is not the derivative of an energy.
    """

    def __init__(
        self,
        scene: Scene,
        fabric: Fabric,
        state: State,
        *,
        laws: Laws | None = None,
        extra: Sequence[Energy] = (),
    ) -> None:
        self.scene, self.fabric, self.laws = scene, fabric, laws or Laws()
        _require_energy(self.laws)
        self._potential = build_potential(scene, fabric, state, laws=self.laws, extra=extra)
        self.q = state.unknowns
        self.softest = 0.0
        self.ok, self.message = self._approach()

    @classmethod
    def of(
        cls, result: DrapeResult, *, laws: Laws | None = None, extra: Sequence[Energy] = ()
    ) -> "Tangent":
        """The tangent of a drape made with ``laws`` and, where it was, ``extra`` energies.

        Not ok where it did not converge. Like the drape it is that of the fabric at the reference
        density, the membrane's stiffness that of ``laws`` there.
        """
        scene, fabric = scene_of(result), result.fabric.at_density(REFERENCE_DENSITY)
        _require_energy(laws or Laws())
        contact = self_contact(result, laws=laws, extra=extra)
        state = State(result.positions, result.rotations)
        tangent = cls(scene, fabric, state, laws=laws, extra=[*extra, *contact])
        if not result.converged:
            tangent._fail(f"the drape is no equilibrium: {result.message}")
        elif not all(energy.is_complete(tangent.q) for energy in contact):
            tangent._fail("self-contact reaches further than the Hessian's pattern")
        return tangent

    @property
    def positions(self) -> np.ndarray:
        """(V, 3) m."""
        return self.q[: self.coordinates].reshape(-1, 3)

    @property
    def coordinates(self) -> int:
        """How many of the unknowns are coordinates; the others are rotations."""
        return 3 * len(self.scene.mesh.rest)

    @property
    def potential(self) -> Potential:
        """All energies of the cloth."""
        return self._potential

    def response(self, force: np.ndarray) -> np.ndarray:
        """(Q,) moves H⁻¹ f under a force ``force`` (Q,), zero where the cloth is held.

        What acts on held unknowns has no effect. NaN where the tangent is not ok.
        """
        if not self.ok:
            return np.full(len(self.q), np.nan)
        move = np.zeros_like(self.q)
        free = self._potential.free_part(np.arange(len(self.q)))
        move[free] = self._solve(self._potential.free_part(self.q), force[free])
        return move

    def force_of(self, move: np.ndarray) -> np.ndarray:
        """(Q,) change of the energy's gradient when the unknowns move by ``move`` (Q,)."""
        return hessian_product(self._potential.energies, self.q, move)

    def force_derivatives(self) -> np.ndarray:
        """See :func:`sim.sensitivity.parameters.force_derivatives`."""
        return force_derivatives(self._potential, self.scene, self.fabric, self.laws, self.q)

    def _approach(self) -> tuple[bool, str]:
        """Take the last Newton steps and factorise; ``ok`` and ``message``."""
        potential = self._potential
        y = potential.free_part(self.q)
        before: SparsePattern | None = None
        for _ in range(_STEPS):
            pattern, data = potential.hessian(y, 0.0)
            if not np.isfinite(data).all():
                return False, "the energy is not a finite number"
            if pattern is not before:
                before, self._solver = pattern, make_solver(pattern)
            if not self._solver.factorise(data):
                return False, "the Hessian is not positive definite: no minimum, or a fold"
            gradient = potential.gradient(y)
            step = self._solve(y, -gradient)
            length = potential.step_length(step)
            if not length < FARTHEST:
                break
            if length < STEP and potential.residual(gradient) < RESIDUAL:
                self.q = potential.full(y)
                self.softest = self._softest(y)
                if self.softest < SOFTEST:
                    return False, "the Hessian is singular: the cloth can move freely, or a fold"
                return True, "equilibrium"
            y = y + step
        return False, f"no equilibrium: Newton's method goes on by {length:.1e} mm"

    def _solve(self, y: np.ndarray, force: np.ndarray) -> np.ndarray:
        """Free unknowns' moves (n,) under forces (n,), by the factor at ``y``."""
        potential = self._potential
        return potential.out_of_frames(y, self._solver.solve(potential.into_frames(y, force)))

    def _softest(self, y: np.ndarray) -> float:
        potential = self._potential
        scale = potential.regularisation
        motion = np.random.default_rng(0).standard_normal(potential.size)
        for _ in range(_POWERS):
            motion /= np.sqrt(scale @ motion**2)
            before, motion = motion, self._solve(y, scale * motion)
        return float(1.0 / (before @ (scale * motion)))

    def _fail(self, message: str) -> None:
        self.ok, self.message, self.softest = False, message, 0.0


def _require_energy(laws: Laws) -> None:
    law = laws.bending_law
    if isinstance(law, HingeLaw) and law.lagged:
        raise InputError("hinge laws that follow the direction of bending are not the derivative "
                         "of an energy; choose midedge or hinge")


def scene_of(result: DrapeResult) -> Scene:
    """The scene of a drape."""
    mesh = Mesh(rest=result.rest, faces=result.faces)
    return Scene(mesh=mesh, held=result.held, obstacles=result.rig.obstacles)


def possible_contact(result: DrapeResult) -> SelfContact:
    """The contact of a drape with itself, as :mod:`sim.self_contact` would add it; zero for most
    drapes."""
    return contact_near(scene_of(result), result.positions, density=REFERENCE_DENSITY)


def self_contact(
    result: DrapeResult, *, laws: Laws | None = None, extra: Sequence[Energy] = ()
) -> list[SelfContact]:
    """The contact with itself that holds a converged drape in balance; none for most.

    A drape that met itself on its way is in equilibrium only together with the contact energy of
    :mod:`sim.self_contact`, which then takes away most of the other energies' forces.

    Args:
        laws: those of the drape, or not far from them.
        extra: more energies that it is in balance with.
    """
    scene, fabric = scene_of(result), result.fabric.at_density(REFERENCE_DENSITY)
    state = State(result.positions, result.rotations)
    terms = cloth_terms(scene, fabric, state, laws=laws)
    energies = [*(energy for stage in terms.stages for energy in stage), *extra]

    def unbalanced(energies: Sequence[Energy]) -> np.ndarray:
        return (forces(energies, terms.template) / terms.force_scale)[terms.free]

    without = unbalanced(energies)
    if not result.converged or np.abs(without).max() < _BALANCED:
        return []
    contact = possible_contact(result)
    rest = without + unbalanced([contact])
    return [contact] if np.linalg.norm(rest) < 0.5 * np.linalg.norm(without) else []
