"""Equilibria of laws whose moduli follow the direction of bending, found by repetition.

Such a law is not the derivative of an energy. Its directions are held while Newton's method finds
an equilibrium, taken anew from the result, and so on until the cloth stays where it is.
"""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from sim.anisotropy import hinge_directions
from sim.energies.base import Energy
from sim.equilibrium import STEP_UNIT, find_equilibrium
from sim.hinge_laws import HingeLaw
from sim.laws import Laws
from sim.material import Fabric
from sim.newton import NewtonOptions, NewtonResult, Status
from sim.scene import Scene, State

RELAXATION = 0.7
"""Share of the new directions that a round takes. Directions of one round in full settled for the
twelve most anisotropic of 201 measured fabrics too, in about one round less; this is a margin."""


@dataclass(frozen=True)
class Settling:
    """How the repetition ended.

    Attributes:
        rounds: equilibria found; 1 for laws that need no repetition.
        change: mm, largest move of a vertex in the last round, divided by the relaxation;
            infinite after a single round of a law that needs repetition.
        settled: whether ``change`` fell below the tolerance.
    """

    rounds: int
    change: float
    settled: bool


def find_settled_equilibrium(
    scene: Scene,
    fabric: Fabric,
    start: State,
    *,
    laws: Laws | None = None,
    extra: Sequence[Energy] = (),
    options: NewtonOptions | None = None,
    tolerance: float = 0.01,
    max_rounds: int = 40,
    relaxation: float = RELAXATION,
    find: Callable[..., tuple[State, NewtonResult]] = find_equilibrium,
) -> tuple[State, NewtonResult, Settling]:
    """Equilibrium of ``fabric`` in ``scene`` next to ``start`` under any laws.

    The first directions are those of ``start``; where it is flat, the mean modulus stands in.

    Args:
        laws, extra, options: as for :func:`sim.equilibrium.find_equilibrium`.
        tolerance: mm, of :attr:`Settling.change`.
        max_rounds: equilibria to find at most.
        relaxation: in (0, 1], share of the new directions that a round takes.
        find: finds one equilibrium, called like :func:`sim.equilibrium.find_equilibrium`.

    Returns:
        The state, the last round's result with the iterations and seconds of all rounds, and how
        the directions settled. A round that does not converge ends the repetition; directions
        that do not settle are no equilibrium either, MAX_ITERATIONS.
    """
    laws = laws or Laws()
    law = laws.bending_law
    if not (isinstance(law, HingeLaw) and law.lagged):
        state, result = find(scene, fabric, start, laws=laws, extra=extra, options=options)
        return state, result, Settling(rounds=1, change=0.0, settled=True)

    mesh, active = scene.mesh, scene.active
    axes = hinge_directions(mesh, active, start.positions)
    state, change, iterations, seconds = start, np.inf, 0, Counter()
    for rounds in range(1, max_rounds + 1):
        laws = replace(laws, bending=replace(law, axes=axes))
        before = state
        state, result = find(scene, fabric, before, laws=laws, extra=extra, options=options)
        iterations += result.iterations
        seconds.update(result.seconds)
        if result.status is not Status.CONVERGED:
            break
        if rounds > 1:
            moved = np.linalg.norm(state.positions - before.positions, axis=1).max()
            change = moved / STEP_UNIT / relaxation
            if change < tolerance:
                break
        fresh = hinge_directions(mesh, active, state.positions)
        axes = (1 - relaxation) * axes + relaxation * fresh if rounds > 1 else fresh
    result = replace(result, iterations=iterations, seconds=dict(seconds))
    settled = bool(result.status is Status.CONVERGED and change < tolerance)
    if result.status is Status.CONVERGED and not settled:
        result = replace(
            result, status=Status.MAX_ITERATIONS,
            message=f"the directions of bending do not settle: {change:.2g} mm in the last of "
                    f"{rounds} rounds")
    return state, result, Settling(rounds=rounds, change=float(change), settled=settled)
