"""The equilibrium of other moduli next to a drape, on the same mesh."""

import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sim.drape import FINE_OPTIONS, DrapeResult
from sim.energies.base import Energy
from sim.energies.self_contact import SelfContact
from sim.equilibrium import cloth_terms, find_equilibrium
from sim.lagged import find_settled_equilibrium
from sim.laws import Laws
from sim.material import REFERENCE_DENSITY, Fabric
from sim.newton import NewtonOptions, NewtonResult, Status
from sim.scene import Scene, State
from sim.self_contact import find_free_equilibrium, self_intersections
from sim.sensitivity.forward import Sensitivities
from sim.sensitivity.tangent import scene_of, self_contact


def follow(
    result: DrapeResult,
    fabric: Fabric,
    *,
    laws: Laws | None = None,
    extra: Sequence[Energy] = (),
    options: NewtonOptions | None = None,
    sensitivities: Sensitivities | None = None,
) -> DrapeResult:
    """The drape of ``fabric`` next to ``result``, on its mesh: a warm start in place of a new one.

    A large change of moduli may end in other folds; the way there is a minimisation, not a path
    of equilibria.

    Args:
        laws: of bending and membrane.
        extra: more energies, such as springs that hold the cloth; ``result`` is in balance with
            them if it is in balance at all.
        options: of the minimisation; None for those of a drape.
        sensitivities: of ``result``, by "log_alpha" and "ratio" among others: the search starts at
            the linear prediction where its energy is lower than that of ``result``'s shape.

    Returns:
        The drape; look at its ``status``. Iterations and seconds are those of this search.
    """
    began = time.perf_counter()
    scene, laws = scene_of(result), laws or Laws()
    simulated = fabric.at_density(REFERENCE_DENSITY)
    here = State(result.positions, result.rotations)
    start = here
    if sensitivities is not None and sensitivities.ok:
        there = _predicted(here, result.fabric, fabric, sensitivities)
        start = _better(scene, simulated, laws, extra, here, there)
    state, found = _found(
        scene, simulated, start, laws, extra, options or FINE_OPTIONS,
        self_contact(result, laws=laws, extra=extra),
    )
    return replace(
        result,
        fabric=fabric,
        positions=state.positions,
        rotations=state.rotations,
        status=found.status,
        message=found.message,
        residual=found.residual,
        step=found.step,
        positive_definite=found.positive_definite,
        self_intersections=len(self_intersections(state.positions, scene.mesh.faces)),
        iterations=found.iterations,
        seconds=time.perf_counter() - began,
        time_spent=found.seconds,
    )


def _found(
    scene: Scene,
    fabric: Fabric,
    start: State,
    laws: Laws,
    extra: Sequence[Energy],
    options: NewtonOptions,
    contact: list[SelfContact],
) -> tuple[State, NewtonResult]:
    """Equilibrium next to ``start``, if there is ``contact`` of cloth with itself, with that."""
    if contact:
        state, found = find_equilibrium(scene, fabric, start, laws=laws, options=options,
                                        extra=[*extra, *contact])
        q = state.unknowns
        if found.status is Status.CONVERGED and all(energy.is_complete(q) for energy in contact):
            message = f"{found.message}; self-contact took {found.iterations} iterations"
            return state, replace(found, message=message)
    state, found, _ = find_settled_equilibrium(
        scene, fabric, start, laws=laws, extra=extra, options=options, find=find_free_equilibrium
    )
    return state, found


def _predicted(
    state: State, before: Fabric, after: Fabric, sensitivities: Sensitivities
) -> State:
    """The state moved linearly as the fabric's moduli change."""
    one, two = (fabric.at_density(REFERENCE_DENSITY) for fabric in (before, after))
    change = np.concatenate([np.log(two.alpha / one.alpha),
                             two.beta / two.alpha - one.beta / one.alpha])
    rows = [sensitivities.names.index(f"{name}_{direction}")
            for name in ("log_alpha", "ratio") for direction in ("warp", "bias", "weft")]
    return State(
        state.positions + np.tensordot(change, sensitivities.positions[rows], 1),
        state.rotations + change @ sensitivities.rotations[rows],
    )


def _better(
    scene: Scene, fabric: Fabric, laws: Laws, extra: Sequence[Energy], here: State, there: State
) -> State:
    """``there`` if the energy allows going there and is lower than ``here``."""
    terms = cloth_terms(scene, fabric, here, laws=laws)
    energies = [*(energy for stage in terms.stages for energy in stage), *extra]
    old, new = here.unknowns, there.unknowns
    with np.errstate(all="ignore"):
        falls = sum(e.value(new) for e in energies) < sum(e.value(old) for e in energies)
    return there if falls and all(e.allows(old, new) for e in energies) else here
