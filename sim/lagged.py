"""Equilibria of laws whose moduli follow the direction of bending, found by repetition.

Such a law is not the derivative of an energy. Its directions are held while Newton's method finds
an equilibrium, taken anew from the result, and so on until the cloth stays where it is.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import TypeVar

import numpy as np

from sim.hinge_laws import HingeLaw, hinge_directions
from sim.laws import Laws
from sim.newton import Status
from sim.scene import Scene
from sim.state import State

Found = TypeVar("Found")
"""A :class:`sim.equilibrium.Equilibrium`."""
RELAXATION = 0.7
"""Share of the new directions that a round takes. Directions of one round in full settled for the
twelve most anisotropic of 201 measured fabrics too, in about one round less; this is a margin."""
TOLERANCE = 0.01  # mm, of the largest move of a vertex in a round over the relaxation
MAX_ROUNDS = 40


def settled(
    find: Callable[[State, Laws], Found], scene: Scene, start: State, laws: Laws
) -> Found:
    """The equilibrium that ``find`` gives, with directions of bending that agree with it.

    The first directions are those of ``start``; where it is flat, the mean modulus stands in. A
    round that does not converge ends the repetition; directions that do not settle are no
    equilibrium either, MAX_ITERATIONS. The result's ``rounds`` and ``change`` (mm) state how it
    went, its work is that of all rounds.

    Args:
        find: finds one equilibrium from a state under laws.
    """
    law = laws.bending_law
    if not follows_curvature(laws):
        return find(start, laws)
    mesh, active = scene.mesh, scene.active
    axes = hinge_directions(mesh, active, start.positions)
    state, found, change = start, None, np.inf
    for rounds in range(1, MAX_ROUNDS + 1):
        round_ = find(state, replace(laws, bending=replace(law, axes=axes)))
        found = round_ if found is None else round_.after(found.newton)
        before, state = state, found.state
        if not found.converged:
            break
        if rounds > 1:
            moved = np.linalg.norm(state.positions - before.positions, axis=1).max()
            change = 1e3 * moved / RELAXATION
            if change < TOLERANCE:
                break
        fresh = hinge_directions(mesh, active, state.positions)
        axes = (1 - RELAXATION) * axes + RELAXATION * fresh if rounds > 1 else fresh
    found = replace(found, rounds=rounds, change=float(change))
    if found.converged and not change < TOLERANCE:
        return found.ended(
            Status.MAX_ITERATIONS, f"the directions of bending do not settle: {change:.2g} mm in "
                                   f"the last of {rounds} rounds")
    return found


def follows_curvature(laws: Laws) -> bool:
    """Whether the bending law depends on directions of a previous solution."""
    law = laws.bending_law
    return isinstance(law, HingeLaw) and law.lagged
