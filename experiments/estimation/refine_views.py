"""Refinement of captures of known fabrics.

Fabrics from the prior are lowered onto the plate on a finer mesh than that of the refinement,
captured, and estimated by the network and by the refinement; both posteriors are compared with the
truth. With ``variation=real`` specimens and captures have all nuisances. With ``none`` the specimen
is ideal, and the sensor ``smooth`` takes four views at exact quarter turns, with true intrinsics,
an exact cut-out and a random camera pose.
"""

import time
from dataclasses import replace
from itertools import compress
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from common.configs import read_option
from common.types import Theta
from data.fabrics.fabrics import THETA_NAMES
from data.fabrics.nuisances import NAMES
from data.render.setups import Setups
from drapenet.network.posterior import inside, ranks
from experiments.comparison import same_folds
from experiments.drapes import (
    CLEAN,
    as_read,
    capture_drape,
    drape_as_planned,
    header,
    plan_specimen,
)
from experiments.result import (
    Config,
    Result,
    load_arrays,
    rms,
    run_cases,
)
from sim.draping import drape
from sim.material import LINEAR, RATIO
from sim.measures import fold_outline
from sim.rig import Rig

if TYPE_CHECKING:
    from drapenet.refine.refine import Refinement
    from drapenet.result.estimate import Estimate

METHODS = ("network", "search", "refined")


def case(
    *, number: int, rig: str, nuisances: str, edge_mm: float | None, truth_mm: float, seed: int
) -> dict:
    """Estimate one capture with the network and with the refinement."""
    from drapenet.fabric.stages import by_network
    from drapenet.refine.refine import refine_capture

    tester = Rig.from_name(rig)
    plan = plan_specimen(number, rig=tester, nuisances=nuisances, seed=seed)
    shape = drape_as_planned(plan, edge=1e-3 * truth_mm)
    setups = replace(Setups.load("real"), **(CLEAN if nuisances == "none" else {}))
    rng = np.random.default_rng([seed, number])
    capture = as_read(capture_drape(shape, setups, rng, tester), tester)
    inferred = by_network(capture, header())
    estimate = inferred.estimate
    began = time.perf_counter()
    settings = read_option("refine", "simulation")
    if edge_mm is not None:
        settings["edge_mm"] = edge_mm
    refined = refine_capture(inferred.draws.cloth, inferred.observed.views, header(),
                             density=capture.density, warp=capture.warp_direction,
                             settings=settings)
    seconds = time.perf_counter() - began
    gained = refined is not None and refined.draws is not None
    first = drape(estimate.fabric, rig=tester, seed=number)
    outlines = [fold_outline(d.positions, d.rest, tester) for d in (shape, first)]
    return {"theta": plan.theta.tolist(), "nuisances": plan.nuisances.vector.tolist(),
            "specimen": refined.content["specimen"] if refined else {},
            "other_folds": not same_folds(*outlines), "seconds": seconds,
            "views": len(capture.views), "gained": gained,
            "status": refined.content["status"] if refined else "none",
            "spread": estimate.spread.tolist(),
            "arrays": searched_samples(refined, estimate)}


def searched_samples(
    refined: "Refinement | None", estimate: "Estimate"
) -> dict[str, np.ndarray]:
    """Samples of theta of the network and of the search alone, at 300 g/m²; without an improvement
    those of the network."""
    samples = estimate.samples
    if refined is None or refined.searched is None:
        return {"network": samples, "search": samples}
    theta, rng = slice(len(THETA_NAMES)), np.random.default_rng(0)
    return {"network": samples, "search": rng.multivariate_normal(
        refined.searched.mean[theta], refined.searched.covariance[theta, theta],
        size=len(samples))}


def with_pool(arrays: dict[str, np.ndarray], *, gained: bool) -> dict[str, np.ndarray]:
    """Samples of a case, and those of the refined estimate."""
    from drapenet.refine.refine import pooled

    network = arrays["network"]
    return arrays | {"refined": pooled(network, arrays["search"]) if gained else network}


def nuisance_errors(results: list[dict]) -> dict[str, dict[str, float]]:
    """Root mean square errors and estimated deviations of the natural curvatures, by name.

    In units of their spread over specimens.
    """
    deviations = header().nuisances.deviations
    found = {}
    for name in ("curl_warp", "curl_weft"):
        label = f"{name}_per_m"
        rows = [(r["specimen"][label], r["nuisances"][NAMES.index(name)]) for r in results
                if label in r["specimen"]]
        if rows:
            error = np.array([one["median"] - truth for one, truth in rows])
            size = np.array([np.diff(one["interval_68"])[0] / 2 for one, _ in rows])
            found[name] = {kind: rms(values) / deviations[name]
                           for kind, values in (("error", error), ("estimated", size))}
    return found


def posterior_errors(truth: Theta, samples: list[Theta]) -> dict:
    """Errors of posterior means, and coverage of intervals, from samples of each capture."""
    errors = np.stack([s.mean(axis=0) for s in samples]) - truth
    places = np.concatenate([ranks(s[:, None], t[None])
                             for s, t in zip(samples, truth, strict=True)])
    return {
        "log_alpha": rms(errors[:, LINEAR]),
        "log_alpha_median": float(np.median(np.abs(errors[:, LINEAR]))),
        "log_alpha_worst_fabric": float(np.abs(errors[:, LINEAR]).mean(axis=1).max()),
        "beta_over_alpha_mm": 1e3 * rms(errors[:, RATIO]),
        "inside": inside(places),
        "fabrics": len(truth),
    }


def run(config: Config) -> Result:
    """Refine all captures."""
    folder = Path(config["cases"]) / config["variation"]
    settings = {key: config[key] for key in ("rig", "edge_mm", "truth_mm", "seed")}
    settings["nuisances"] = config["variation"]
    results = run_cases(case, {f"views_{k}": {"number": k, **settings}
                               for k in range(config["fabrics"])},
                        config, folder=folder)
    truth = np.array([r["theta"] for r in results.values()])
    arrays = [with_pool(load_arrays(folder, name), gained=r["gained"])
              for name, r in results.items()]
    samples = {way: [each[way] for each in arrays] for way in METHODS}
    other = np.array([r["other_folds"] for r in results.values()])
    groups = {"all": np.ones(len(truth), bool), "other folds": other}
    summary = {
        group: {way: posterior_errors(truth[rows], list(compress(samples[way], rows)))
                for way in METHODS}
        for group, rows in groups.items() if rows.any()}
    seconds = np.array([r["seconds"] for r in results.values()])
    specimen = nuisance_errors(list(results.values()))
    return Result({"summary": summary, "specimen": specimen,
                   "seconds": {"median": float(np.median(seconds)),
                               "largest": float(seconds.max())}, "cases": results})
