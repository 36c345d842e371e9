"""Refinement of simulated scans of drapes.

The scans are point clouds of drapes of known fabrics, simulated on a finer mesh with all
nuisances, with noise. Each is registered, estimated and refined as by ``infer.py scan=FILE
refine=simulation``. Errors are those at 300 g/m².
"""

import time
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from common.errors import InputError
from common.findings import texts
from experiments.drapes import drape_as_planned, header, plan_specimen
from experiments.estimation.refine_views import (
    METHODS,
    nuisance_errors,
    posterior_errors,
    searched_samples,
    with_pool,
)
from experiments.result import Config, Result, load_arrays, run_cases
from sim.material import REFERENCE_DENSITY
from sim.rig import DISC_RIG

if TYPE_CHECKING:
    from drapenet.surface.registration import ScanRegistration

_TRUTH_MM = 2.0  # mesh edges at the rim of simulated specimens


def simulated(*, number: int, noise_mm: float, seed: int) -> dict:
    """Refine a simulated raw scan of a known fabric."""
    from drapenet.surface.registration import EDGE, register
    from drapenet.surface.shape import Cloud

    plan = plan_specimen(number, rig=DISC_RIG, nuisances="real", seed=seed)
    shape = drape_as_planned(plan, edge=1e-3 * _TRUTH_MM)
    noise = np.random.default_rng([seed, number]).normal(0, 1e-3 * noise_mm, shape.positions.shape)
    cloud = Cloud.of_mesh(shape.positions + noise, shape.faces)
    result = refine_scan(register(cloud, DISC_RIG, edge=EDGE))
    return result | {"truth": plan.theta.tolist(), "nuisances": plan.nuisances.vector.tolist(),
                     "specimen": result["refined"]["specimen"]}


def refine_scan(scan: "ScanRegistration") -> dict:
    """Estimate a scan whose x axis is the warp, as by ``infer.py scan=FILE refine=simulation``."""
    from drapenet.fabric.stages import by_network
    from drapenet.refine.refine import refine_capture
    from drapenet.surface.registration import scan_capture

    shape = scan.shape
    capture = scan_capture(Path("scan"), shape, REFERENCE_DENSITY, 0.0)
    inferred = by_network(capture, header())
    estimate = inferred.estimate
    began = time.perf_counter()
    result = refine_capture(inferred.draws.cloth, inferred.observed.views, header(),
                            density=capture.density, warp=0.0, scan=shape)
    if result is None:
        raise InputError("no simulated cloth converges at the scan")
    return {"refined": result.content, "gained": result.draws is not None,
            "seconds": time.perf_counter() - began, "registered_mm": 1e3 * scan.distance,
            "spread": estimate.spread.tolist(), "warnings": texts(result.warnings),
            "arrays": searched_samples(result, estimate)}


def run(config: Config) -> Result:
    """Refine all scans."""
    folder = Path(config["cases"])
    results = run_cases(simulated, {
        f"simulated_{k}": {"number": k, "noise_mm": config["noise_mm"], "seed": config["seed"]}
        for k in range(config["fabrics"])},
        config, folder=folder)
    truth = np.array([r["truth"] for r in results.values()])
    arrays = [with_pool(load_arrays(folder, name), gained=r["gained"])
              for name, r in results.items()]
    summary = {way: posterior_errors(truth, [own[way] for own in arrays]) for way in METHODS}
    summary["specimen"] = nuisance_errors(list(results.values()))
    away = [r["refined"].get("fidelity", {}).get("displacement_mm") for r in results.values()]
    rest = [value for value in away if value is not None]
    seconds = float(np.median([r["seconds"] for r in results.values()]))
    return Result({"summary": summary, "mean_away_mm": float(np.mean(rest)), "seconds": seconds,
                   "scans": results})
