"""The equilibrium of other moduli next to a drape, on the same mesh."""

import time
from collections.abc import Sequence

import numpy as np

from sim.cloth import Cloth
from sim.drape import FINE_OPTIONS, DrapeResult, drape_result
from sim.energies.base import Energy
from sim.equilibrium import find_equilibrium
from sim.laws import Laws
from sim.material import REFERENCE_DENSITY, Fabric
from sim.newton import NewtonOptions
from sim.sensitivity.forward import Sensitivities
from sim.state import State


def follow(
    result: DrapeResult, fabric: Fabric, *, laws: Laws | None = None, extra: Sequence[Energy] = (),
    options: NewtonOptions | None = None, sensitivities: Sensitivities | None = None,
    keep: bool = False
) -> DrapeResult:
    """The drape of ``fabric`` next to ``result``, on its mesh: a warm start in place of a new one.

    A large change of moduli may end in other folds; the way there is a minimisation, not a path
    of equilibria. Iterations and seconds of the drape are those of this search.

    Args:
        laws, options: None for those of ``result``, and of a drape.
        extra: more energies, such as springs that hold the cloth.
        sensitivities: of ``result``, by "log_alpha" and "ratio" among others: the search starts at
            the linear prediction where its energy is lower than that of ``result``'s shape.
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
    """``before`` moved linearly as the moduli change, if the energy allows it and falls."""
    one, two = before.simulated, cloth.fabric
    change = np.concatenate([np.log(two.alpha / one.alpha),
                             two.beta / two.alpha - one.beta / one.alpha])
    rows = [sensitivities.names.index(f"{name}_{direction}")
            for name in ("log_alpha", "ratio") for direction in ("warp", "bias", "weft")]
    step = change @ sensitivities.moves[rows]
    potential, old = cloth.potential, before.state.q
    new = potential.moved(old, potential.free_unknowns(step))
    with np.errstate(all="ignore"):
        falls = potential.value(new) < potential.value(old)
    good = falls and potential.allows(old, new)
    return State.of(new, len(cloth.scene.mesh.rest)) if good else before.state
