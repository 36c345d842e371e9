"""Static equilibrium of a cloth in a scene, with self-contact where the cloth needs it."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from common.types import Points
from sim.cloth import Cloth, Laws
from sim.energies.base import Energy
from sim.energies.self_contact import SelfContact, contact_near, self_intersections
from sim.material import Fabric
from sim.mesh import Mesh, adjacency, smooth
from sim.scene import Scene
from sim.solver.newton import NewtonOptions, NewtonResult, Status, minimise
from sim.solver.state import State

_DERIVATIVES = "wrong derivatives in Laws.others are one cause: sim.energies.base.check finds them"
_MAX_UNTANGLING_ROUNDS = 60
_STEPS_PER_ROUND = 25  # Newton steps between updates of the pattern of self-contact
Found = TypeVar("Found", bound="Equilibrium")


@dataclass(frozen=True, eq=False, kw_only=True)
class Equilibrium:
    """An equilibrium of a cloth, or the last state of a failed search.

    The ``outcome`` is that of the last minimisation, with iterations and seconds of all; None for
    a shape that was not sought by a simulation, such as a captured one.
    """

    cloth: Cloth
    state: State
    outcome: NewtonResult | None = None
    touches: bool = False  # whether self-contact acts; it is among the extra energies of the cloth

    @property
    def positions(self) -> Points:
        """Positions of the vertices."""
        return self.state.positions

    @property
    def status(self) -> Status | None:
        """Outcome of the search."""
        return self.outcome.status if self.outcome else None

    @property
    def message(self) -> str:
        """The outcome as a sentence."""
        return self.outcome.message if self.outcome else "a shape, not an equilibrium"

    @property
    def converged(self) -> bool:
        """Whether the state is a verified equilibrium."""
        return self.status is Status.CONVERGED

    @property
    def searched(self) -> NewtonResult:
        """The outcome, of a shape that was sought by a simulation."""
        assert self.outcome, "a shape, not an equilibrium"
        return self.outcome

    def ended(self, status: Status, message: str) -> "Equilibrium":
        """A copy with another outcome."""
        return replace(self, outcome=replace(self.searched, status=status, message=message))

    def after(self, earlier: "Equilibrium | None") -> "Equilibrium":
        """A copy with iterations and seconds of an ``earlier`` search, if any, added."""
        if earlier is None:
            return self
        first, second = earlier.searched, self.searched
        return replace(self, outcome=replace(
            second, iterations=first.iterations + second.iterations,
            seconds=first.seconds + second.seconds))

    def __getstate__(self) -> dict:
        return light(self).__dict__


def light(found: Found) -> Found:
    """A copy without the energies and factor of its minimisation, which take much memory."""
    extra = tuple(e for e in found.cloth.extra if not isinstance(e, SelfContact))
    outcome = found.outcome and replace(found.outcome, factor=None)
    return replace(found, cloth=replace(found.cloth, extra=extra), outcome=outcome)


def find_equilibrium(
    scene: Scene, fabric: Fabric, start: State, *, laws: Laws | None = None,
    extra: Sequence[Energy] = (), options: NewtonOptions | None = None, self_contact: bool = False,
    touching: bool = False
) -> Equilibrium:
    """Find the equilibrium of ``fabric`` in ``scene`` near ``start``; ``status`` gives the outcome.

    Held vertices keep their positions of ``start``. Numerical failures raise no exception.

    Args:
        self_contact: whether self-intersections are resolved. The equilibrium without
            self-contact comes first and suffices for most drapes. If it intersects itself, it is
            untangled and minimised again with contact
            (:class:`sim.energies.self_contact.SelfContact`), which no step can pass. Status
            SELF_CONTACT: untangling failed, or the result intersects itself again.
        touching: with ``self_contact``, whether the cloth already touches itself in ``start``, so
            that contact acts from the first step.
    """
    laws, options = laws or Laws(), options or NewtonOptions()

    def minimised(
        state: State, contact: SelfContact | None = None, options: NewtonOptions = options
    ) -> Equilibrium:
        cloth = Cloth(scene, fabric, laws=laws, extra=[*extra, contact] if contact else extra)
        outcome = minimise(cloth.potential, state.q, options)
        if laws.others and outcome.status in (Status.MAX_ITERATIONS, Status.LINE_SEARCH):
            outcome = replace(outcome, message=f"{outcome.message}; {_DERIVATIVES}")
        return Equilibrium(cloth=cloth, state=State.of(outcome.q, len(scene.mesh.rest)),
                           outcome=outcome, touches=contact is not None)

    first = None
    if self_contact and touching:
        contact = contact_near(scene, start.positions)
        first = minimised(start, contact)
        if first.converged and contact.is_complete(first.state.q):
            return first
    free = minimised(start).after(first)
    if not (self_contact and free.converged):
        return free
    count = len(self_intersections(free.positions, scene.mesh.faces))
    if count == 0:
        return free
    positions = untangled(scene.mesh, scene.held, free.positions)
    if positions is None:
        return free.ended(Status.SELF_CONTACT, f"intersects itself in {count} places and could "
                                               "not be untangled")
    last = _with_contact(minimised, scene, scene.state(positions), options)
    last = last.after(free)
    count = len(self_intersections(last.positions, scene.mesh.faces))
    if count:
        return last.ended(Status.SELF_CONTACT,
                          f"intersects itself in {count} places ({last.message})")
    return last


def _with_contact(
    minimised: Callable[[State, SelfContact, NewtonOptions], Equilibrium], scene: Scene,
    state: State, options: NewtonOptions,
) -> Equilibrium:
    """Equilibrium with self-contact, started from a ``state`` without intersections."""
    iterations, last = 0, None
    while True:
        contact = contact_near(scene, state.positions)
        steps = min(_STEPS_PER_ROUND, options.max_iterations - iterations)
        reached = minimised(state, contact, replace(options, max_iterations=steps))
        iterations += max(reached.searched.iterations, 1)  # rounds without a step count, too
        last = reached.after(last)
        state = last.state
        exact = contact.is_complete(state.q)
        ended = last.status is not Status.MAX_ITERATIONS and exact
        if ended or iterations >= options.max_iterations:
            break
    status = last.searched.status
    if last.converged and not exact:
        status = Status.MAX_ITERATIONS  # verified only with an approximate Hessian
    return last.ended(status, f"{last.message}; self-contact took {iterations} iterations")


def untangled(mesh: Mesh, held: np.ndarray, positions: Points) -> Points | None:
    """Positions near the given ones without intersections; None if none are found.

    Vertices around each intersection move repeatedly half-way to the mean of their neighbours, in
    a neighbourhood and number that grow with the rounds. Those ``held`` (V,) are fixed.
    """
    vertices, adjacent, x = len(positions), adjacency(mesh), positions.copy()
    for step in range(_MAX_UNTANGLING_ROUNDS):
        crossing = self_intersections(x, mesh.faces)
        if len(crossing) == 0:
            return x
        around = np.zeros(vertices, dtype=bool)
        around[crossing[:, :2]] = around[mesh.faces[crossing[:, 2]]] = True
        for _ in range(1 + step // 6):
            around |= adjacent @ around > 0
        moving = around & ~held
        for _ in range(2 + step // 4):
            smooth(x, moving, adjacent)
    return None
