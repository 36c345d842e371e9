"""Equilibrium of a fabric near a drape of another fabric, on the same mesh."""

import time
from collections.abc import Sequence

import numpy as np

from sim.cloth import Cloth, Laws
from sim.drape import FINE_OPTIONS, DrapeResult, drape_result
from sim.energies.base import Energy
from sim.equilibrium import find_equilibrium
from sim.material import REFERENCE_DENSITY, Fabric
from sim.sensitivity.forward import Sensitivities
from sim.solver.newton import NewtonOptions
from sim.solver.state import State


def follow(
    result: DrapeResult, fabric: Fabric, *, laws: Laws | None = None, extra: Sequence[Energy] = (),
    options: NewtonOptions | None = None, sensitivities: Sensitivities | None = None,
    keep: bool = False
) -> DrapeResult:
    """The drape of ``fabric`` near ``result``, on its mesh, by a warm start.

    A large change of moduli may lead to other folds, as this is a minimisation, not a continuation
    along a path of equilibria. Iterations and seconds of the drape are those of this search.

    Args:
        laws, options: None for the laws of ``result`` and the options of a drape.
        extra: further energies, such as springs that hold the cloth.
        sensitivities: of ``result``, including "log_alpha" and "ratio". The initial guess is then
            the linear prediction if its energy is lower than that of ``result``'s shape.
        keep: whether the drape keeps its energies and factor, for derivatives.
    """
    began = time.perf_counter()
    laws = laws or result.laws
    simulated = fabric.at_density(REFERENCE_DENSITY)
    scene, start = result.scene, result.state
    if sensitivities is not None and sensitivities.ok:
        cloth = Cloth(scene, simulated, laws=laws, extra=extra)
        start = _predicted(cloth, result, sensitivities)
    found = find_equilibrium(scene, simulated, start, laws=laws, extra=extra,
                             options=options or FINE_OPTIONS, self_contact=True,
                             touching=result.touches)
    return drape_result(fabric, result.rig, laws, found, edge=result.edge, extra=extra,
                        seconds=time.perf_counter() - began, keep=keep)


def _predicted(cloth: Cloth, before: DrapeResult, sensitivities: Sensitivities) -> State:
    """Linear prediction from ``before`` for the change of moduli, if the energy allows it and is
    lower there; else the state of ``before``."""
    one, two = before.simulated, cloth.fabric
    change = np.concatenate([np.log(two.alpha / one.alpha),
                             two.beta / two.alpha - one.beta / one.alpha])
    rows = [sensitivities.names.index(f"{name}_{direction}")
            for name in ("log_alpha", "ratio") for direction in ("warp", "bias", "weft")]
    step = change @ sensitivities.moves[rows]
    potential, old = cloth.potential, before.state.q
    new = potential.moved(old, potential.free_unknowns(step))
    with np.errstate(all="ignore"):
        lower = potential.value(new) < potential.value(old)
    accepted = lower and potential.allows(old, new)
    return State.of(new, len(cloth.scene.mesh.rest)) if accepted else before.state
