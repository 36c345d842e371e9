"""Which constant modulus drapes as a fabric does whose stiffness changes with curvature.

Most tools have one modulus a direction and no beta. Each fabric of the prior is draped with its
own law, and with the secants alpha + beta*kappa of its law at each of several curvatures as
constant moduli, on the same meshes from the same starts. Compared are the mean drape coefficients
and numbers of folds of the seeds: at one curvature for all fabrics, they should agree.
"""

from typing import Any

import numpy as np

from experiments.drapes import prior_fabric
from experiments.result import Config, Report, Result, rms, run_cases
from sim.draping import drape
from sim.material import Fabric, secant
from sim.measures import drape_coefficient, fold_count
from sim.rig import Rig

LAW = "law"


def draped(
    *, number: int, rig: str, curvature: float | None, edge_mm: float, seeds: int, seed: int
) -> dict[str, Any]:
    """Drape coefficients, %, and folds of a fabric of the prior; ``curvature``, 1/m: with the
    constant moduli of its secants there in place of its law."""
    fabric, place = prior_fabric(number, seed), Rig.from_name(rig)
    if curvature is not None:
        fabric = Fabric(secant(curvature, fabric.alpha, fabric.beta))
    shapes = [drape(fabric, rig=place, edge=1e-3 * edge_mm, seed=k) for k in range(seeds)]
    return {"converged": all(shape.converged for shape in shapes), "coefficients": [
        100 * drape_coefficient(shape.positions, shape.faces, place) for shape in shapes],
        "folds": [fold_count(shape.positions, shape.rest, place) for shape in shapes]}


def run(config: Config) -> Result:
    """Drape all fabrics on all testers."""
    common = {key: config[key] for key in ("edge_mm", "seeds", "seed")}
    laws = {LAW: None, **{f"{kappa:g}": float(kappa) for kappa in config["curvatures"]}}
    cases = {f"{rig}_{name}_{k:02}": common | {"number": k, "rig": rig, "curvature": kappa}
             for rig in config["testers"] for k in range(config["fabrics"])
             for name, kappa in laws.items()}
    found, testers = run_cases(draped, cases, config), {}
    for rig in config["testers"]:
        rows = {name: [found[f"{rig}_{name}_{k:02}"] for k in range(config["fabrics"])]
                for name in laws}
        testers[rig] = {name: {key: [float(np.mean(one[key])) for one in row]
                               for key in ("coefficients", "folds")} for name, row in rows.items()}
    return Result({"testers": testers, "summary": summary(testers), "failed": sorted(
        name for name, one in found.items() if not one["converged"])})


def summary(testers: Report) -> Report:
    """Differences of constant moduli from the law by curvature, for each tester and all."""
    report = {}
    for name, rigs in {**{rig: [rig] for rig in testers}, "all": list(testers)}.items():
        report[name] = {kappa: {key: _differences(np.concatenate([
            np.subtract(testers[rig][kappa][key], testers[rig][LAW][key]) for rig in rigs]))
            for key in ("coefficients", "folds")}
            for kappa in testers[rigs[0]] if kappa != LAW}
    return report


def _differences(of: np.ndarray) -> dict[str, float]:
    return {"mean": float(of.mean()), "rms": rms(of), "largest": float(np.abs(of).max())}
