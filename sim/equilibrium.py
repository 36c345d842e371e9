"""Static equilibrium of a cloth in a scene: the one way to find it, whatever acts on the cloth."""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from sim.cloth import Cloth
from sim.energies.base import Energy
from sim.energies.self_contact import SelfContact
from sim.laws import Laws
from sim.material import Fabric
from sim.newton import NewtonOptions, NewtonResult, Status, minimise
from sim.scene import Scene
from sim.self_contact import contact_near, self_intersections, untangled
from sim.state import State

_DERIVATIVES = "wrong derivatives in Laws.others are one cause: sim.energies.check finds them"
_STEPS_A_ROUND = 25  # Newton steps after which the places of self-contact are chosen again


@dataclass(eq=False)
class Equilibrium:
    """Where a cloth came to rest, or how far it came, with what made it.

    Attributes:
        cloth: its energies, contact of cloth with itself among the ``extra`` ones.
        state: positions and edge normals.
        newton: the last minimisation, with the work of all.
        contact: of the cloth with itself, where it acts.
    """

    cloth: Cloth
    state: State
    newton: NewtonResult
    contact: SelfContact | None = None

    @staticmethod
    def at(cloth: Cloth, state: State) -> "Equilibrium":
        """A state that is taken for an equilibrium of ``cloth``, without a minimisation."""
        return Equilibrium(cloth, state, NewtonResult(state.q, Status.MAX_ITERATIONS, "not sought"))

    @property
    def status(self) -> Status:
        """How it ended."""
        return self.newton.status

    @property
    def message(self) -> str:
        """The same in a sentence."""
        return self.newton.message

    @property
    def converged(self) -> bool:
        """Whether this is a proven equilibrium."""
        return self.status is Status.CONVERGED

    def ended(self, status: Status, message: str) -> "Equilibrium":
        """The same with another outcome."""
        return replace(self, newton=replace(self.newton, status=status, message=message))

    def after(self, earlier: "Equilibrium | None") -> "Equilibrium":
        """The same with the work of an earlier search, if there was one, added."""
        if earlier is None:
            return self
        one, two = earlier.newton, self.newton
        return replace(self, newton=replace(
            two, iterations=one.iterations + two.iterations,
            factorisations=one.factorisations + two.factorisations,
            seconds=dict(Counter(one.seconds) + Counter(two.seconds))))


def find_equilibrium(
    scene: Scene, fabric: Fabric, start: State, *, laws: Laws | None = None,
    extra: Sequence[Energy] = (), options: NewtonOptions | None = None, self_contact: bool = False,
    touching: bool = False
) -> Equilibrium:
    """Equilibrium of ``fabric`` in ``scene`` next to ``start``; look at its ``status``.

    Held vertices stay where they are in ``start``. A numerical failure raises nothing.

    Args:
        extra: energies beside those of the cloth, its weight and the scene's obstacles.
        self_contact: whether the cloth may not intersect itself. First the equilibrium without
            contact between its parts is found, which is all for most drapes. Where it intersects
            itself, it is untangled and found again with contact
            (:class:`sim.energies.self_contact.SelfContact`), through which no step leads. Status
            SELF_CONTACT: it could not be untangled, or is tangled again.
        touching: with ``self_contact``, whether the cloth touches itself at the start already, so
            that contact acts from the first step.
    """
    laws, options = laws or Laws(), options or NewtonOptions()

    def minimised(
        state: State, contact: SelfContact | None = None, options: NewtonOptions = options
    ) -> Equilibrium:
        cloth = Cloth(scene, fabric, laws=laws, extra=[*extra, contact] if contact else extra)
        newton = minimise(cloth.potential, state.q, options)
        if laws.others and newton.status in (Status.MAX_ITERATIONS, Status.LINE_SEARCH):
            newton = replace(newton, message=f"{newton.message}; {_DERIVATIVES}")
        return Equilibrium(cloth, State.of(newton.q, len(scene.mesh.rest)), newton, contact)

    touched = None
    if self_contact and touching:
        contact = contact_near(scene, start.positions, density=fabric.density)
        touched = minimised(start, contact)
        if touched.converged and contact.is_complete(touched.state.q):
            return touched
    found = minimised(start).after(touched)
    if not (self_contact and found.converged):
        return found
    count = len(self_intersections(found.state.positions, scene.mesh.faces))
    if count == 0:
        return found
    positions = untangled(scene.mesh, scene.held, found.state.positions)
    if positions is None:
        return found.ended(Status.SELF_CONTACT, f"intersects itself in {count} places and could "
                                                "not be untangled")
    freed = _with_contact(minimised, scene, scene.state(positions), fabric.density, options)
    freed = freed.after(found)
    count = len(self_intersections(freed.state.positions, scene.mesh.faces))
    if count:
        return freed.ended(Status.SELF_CONTACT,
                           f"intersects itself in {count} places ({freed.message})")
    return freed


def _with_contact(
    minimised: Callable[[State, SelfContact, NewtonOptions], Equilibrium], scene: Scene,
    state: State, density: float, options: NewtonOptions,
) -> Equilibrium:
    """Equilibrium with self-contact from a ``state`` without intersections."""
    iterations, found = 0, None
    while True:
        contact = contact_near(scene, state.positions, density=density)
        steps = min(_STEPS_A_ROUND, options.max_iterations - iterations)
        part = minimised(state, contact, replace(options, max_iterations=steps))
        iterations += max(part.newton.iterations, 1)  # rounds without a step must end, too
        found = part.after(found)
        state = found.state
        exact = contact.is_complete(state.q)
        ended = found.status is not Status.MAX_ITERATIONS and exact
        if ended or iterations >= options.max_iterations:
            break
    status = found.status
    if found.converged and not exact:
        status = Status.MAX_ITERATIONS  # a minimum only of an approximate Hessian
    return found.ended(status, f"{found.message}; self-contact took {iterations} iterations")
