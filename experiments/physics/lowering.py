"""Lowered drapes: folds by step, viscosity, speed, mesh and hysteresis; cost beside a ring start.

The specimen is the disc of textile laboratories. Every variant differs from the default in a
single setting.
"""

from dataclasses import replace
from typing import Any

import numpy as np

from experiments.drapes import prior_fabric
from experiments.result import Config, Result, run_cases
from sim.cloth import Laws
from sim.draping import (
    COARSE_CONTACT,
    COARSE_MEMBRANE,
    COARSE_OPTIONS,
    FINE_OPTIONS,
    drape,
    start_positions,
)
from sim.energies.bending_variants import Hysteresis
from sim.equilibrium import find_equilibrium
from sim.lowering import LOWERING_MESHES, RELAXATION, SPEEDS, STEP, lowered, with_origins
from sim.material import MICRO, Fabric
from sim.measures import drape_coefficient, fold_count
from sim.mesh.specimen import TOPOLOGIES
from sim.rig import DISC_RIG
from sim.scene import make_specimen

SEED = 3  # of the fabrics whose cost is measured
DEFAULT = {"step": STEP, "relaxation": RELAXATION, "speed": None,
           "mesh_mm": 1e3 * LOWERING_MESHES[0][0], "share": 0.0}
VARIANTS: dict[str, dict[str, Any]] = {
    "default": {}, "step / 2": {"step": STEP / 2}, "step / 4": {"step": STEP / 4},
    "viscosity / 2": {"relaxation": RELAXATION / 2},
    "viscosity x 2": {"relaxation": 2 * RELAXATION},
    "slowest": {"speed": SPEEDS[0]}, "fastest": {"speed": SPEEDS[1]}, "mesh 7 mm": {"mesh_mm": 7.0},
    **{f"hysteresis {share:g}": {"share": share} for share in (0.05, 0.17, 0.37)},
}


def variant_case(
    *, alpha: float, ratio_mm: float, edge_mm: float, seeds: int, step: float,
    relaxation: float, speed: float | None, mesh_mm: float, share: float
) -> dict[str, Any]:
    """Folds and drape coefficients, %, of drapes lowered with these settings."""
    alphas, rig = np.full(3, alpha * MICRO), DISC_RIG
    fabric, laws = Fabric(alphas, 1e-3 * ratio_mm * alphas), Laws(bending=Hysteresis(share))
    rows = []
    for seed in range(seeds):
        coarse, fine = (make_specimen(rig, edge=1e-3 * edge, topology=seed % TOPOLOGIES)
                        for edge in (mesh_mm, edge_mm))
        coarse = replace(coarse, contact_pressure=COARSE_CONTACT * coarse.contact_pressure)
        before = lowered(coarse, fabric, rig, laws=laws.softened(COARSE_MEMBRANE), seed=seed,
                         speed=speed, step=step, relaxation=relaxation)
        settled = find_equilibrium(
            coarse, fabric, before.state, options=COARSE_OPTIONS,
            laws=with_origins(laws, before, coarse).softened(COARSE_MEMBRANE))
        used = with_origins(laws, before, fine)
        start = fine.state(start_positions(fine, rig, coarse=settled))
        found = find_equilibrium(fine, fabric, start, laws=used, options=FINE_OPTIONS,
                                 self_contact=True)
        positions, mesh = found.state.positions, fine.mesh
        if found.converged:
            rows.append((fold_count(positions, mesh.rest, rig),
                         100 * drape_coefficient(positions, mesh.faces, rig)))
    return {"folds": [folds for folds, _ in rows], "coefficients": [dc for _, dc in rows],
            "failed": seeds - len(rows)}


def cost_case(*, index: int, start: str) -> dict[str, Any]:
    """CPU seconds of a drape of a fabric of the prior on its default mesh."""
    fabric = prior_fabric(index, SEED)
    drape(fabric, rig=DISC_RIG, start=start, seed=index, edge=12e-3)  # compiles
    shape = drape(fabric, rig=DISC_RIG, start=start, seed=index)
    return {"seconds": shape.outcome.seconds, "iterations": shape.iterations,
            "folds": fold_count(shape.positions, shape.rest, DISC_RIG),
            "status": shape.status.value}


def run(config: Config) -> Result:
    """Drape all variants, and the fabrics of the prior from both starts."""
    fabric = {key: config[key] for key in ("ratio_mm", "edge_mm", "seeds")}
    variants = {f"{name.replace(' ', '_').replace('/', 'by')}_{alpha:g}":
                DEFAULT | change | fabric | {"alpha": alpha}
                for name, change in VARIANTS.items() for alpha in config["alphas"]}
    costs = {f"{start}_{index}": {"index": index, "start": start}
             for index in range(config["drapes"]) for start in ("ring", "lowered")}
    found, spent = run_cases(variant_case, variants, config), run_cases(cost_case, costs, config)
    each = len(config["alphas"])
    rows = [{"variant": name, **{
        key: [float(np.mean(one[key])) for one in list(found.values())[each * k: each * (k + 1)]]
        for key in ("folds", "coefficients")}} for k, name in enumerate(VARIANTS)]
    cost = {start: {key: float(np.mean([one[key] for name, one in spent.items()
                                        if name.startswith(start)]))
                    for key in ("seconds", "iterations", "folds")} for start in ("ring", "lowered")}
    return Result({"variants": rows, "cost": cost})
