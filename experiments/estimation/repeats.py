"""Joint estimates of several drapes of one fabric.

Each fabric from the prior is draped several times, with another specimen, start and capture each
time. The captures are estimated one by one, and the first 1, 2, ... of a fabric jointly
(:mod:`drapenet.result.joint`). The errors of two captures of one fabric are correlated, because
they share membrane, hysteresis and natural curvature; ``drapenet.result.joint.SHARED`` is this
correlation. The bound (:mod:`experiments.estimation.bound`) is computed for the same drapes, also
for the curvature.
"""

import math
from pathlib import Path

import numpy as np

from common.configs import read_option
from common.errors import InputError
from data.fabrics.prior import load_prior
from data.render.cameras import nominal_camera
from data.render.setups import Setups
from drapenet.config import EstimateOptions
from drapenet.result.estimate import Estimate
from drapenet.result.joint import joined
from experiments.drapes import (
    along_warp,
    as_read,
    capture_drape,
    drape_as_planned,
    header,
    plan_specimen,
)
from experiments.estimation.bound import CAMERA, SETUP, SPECIMEN, Information, joint_covariance
from experiments.estimation.refine_views import posterior_errors
from experiments.result import ESTIMATOR, Config, Result, load_arrays, rms, run_cases
from sim.material import DIRECTIONS, LINEAR, REFERENCE_DENSITY
from sim.rig import Rig

COUNTS = (1, 2, 5)
CURL_NUISANCES = ("curl_warp", "curl_weft")
CLOTH_NUISANCES = ("membrane", "shear", "hysteresis", *CURL_NUISANCES)
"""Nuisances of the fabric; the others are of the specimen."""


def case(*, number: int, rig: str, drapes: int, refined: bool, truth_mm: float, seed: int) -> dict:
    """Estimate all drapes of one fabric; samples along the true warp, bias and weft."""
    from drapenet.inference import estimate_capture
    from experiments.estimation.bound import depth_information

    tester, setups = Rig.from_name(rig), Setups.load("real")
    arrays = {}
    for index in range(number * drapes, (number + 1) * drapes):
        plan = plan_specimen(index, f"dataset.starts_per_fabric={drapes}", rig=tester,
                             nuisances="real", seed=seed)
        try:
            shape = drape_as_planned(plan, edge=1e-3 * truth_mm)
        except InputError:  # it does not converge
            continue
        synthetic = capture_drape(shape, setups, np.random.default_rng([seed, index]), tester)
        options = EstimateOptions(read_option("refine", "depth") if refined else None, drapes=0)
        estimate = estimate_capture(as_read(synthetic, tester), header(tester), options).estimate
        found = depth_information(shape, nominal_camera(tester), nuisances=plan.nuisances,
                                  orientation=synthetic.orientation)
        arrays[f"samples_{index}"] = along_warp(estimate, synthetic.orientation)
        arrays[f"fisher_{index}"] = found.fisher
    return {"theta": plan.theta.tolist(), "spread": estimate.spread.tolist(), "names": found.names,
            "arrays": arrays}


def bound(names: list[str], fisher: list[np.ndarray]) -> np.ndarray:
    """Smallest standard deviations (6 + S,) of theta and of :data:`CLOTH_NUISANCES`, the latter in
    units of their spread; curvatures without their small part of the specimen."""
    from drapenet.refine.refine import specimen_spread
    from drapenet.refine.unknowns import DRIFT

    setups, deviations = Setups.load("real"), specimen_spread().deviations
    known = dict.fromkeys((SPECIMEN[0], *CAMERA), math.inf) | deviations
    known |= dict.fromkeys(SPECIMEN[1:], DRIFT)
    known |= dict(zip(SETUP, (*[setups.turn] * 3, setups.focal), strict=True))
    found = joint_covariance(
        [Information(tuple(names), one, 0, True, "") for one in fisher],
        np.linalg.inv(load_prior("gaussian").covariance),
        separate={name: value for name, value in known.items() if name not in CLOTH_NUISANCES},
        shared={name: deviations[name] for name in CLOTH_NUISANCES})
    return np.sqrt(np.diag(found)) / [*[1.0] * 6, *(deviations[name] for name in CLOTH_NUISANCES)]


def correlation(errors: list[np.ndarray]) -> np.ndarray:
    """Correlation (6,) of the errors of two captures of one fabric, from the errors of each."""
    pairs = np.concatenate([np.einsum("ik,jk->ijk", one, one)[~np.eye(len(one), dtype=bool)]
                            for one in errors])
    return pairs.mean(axis=0) / np.square(np.concatenate(errors)).mean(axis=0)


def run(config: Config) -> Result:
    """Estimate all fabrics."""
    settings = {key: config[key] for key in ("rig", "drapes", "refined", "truth_mm", "seed")}
    folder = Path(config["cases"]) / ("refined" if config["refined"] else "network")
    results = run_cases(case, {f"fabric_{k}": {"number": k, **settings}
                               for k in range(config["fabrics"])},
                        config, folder=folder, sources=ESTIMATOR)
    truth = np.array([r["theta"] for r in results.values()])
    arrays = [load_arrays(folder, name) for name in results]
    samples, fisher = ([[own[k] for k in own if k.startswith(kind)] for own in arrays]
                       for kind in ("samples", "fisher"))
    errors = [np.stack([s.mean(axis=0) for s in own]) - theta
              for own, theta in zip(samples, truth, strict=True)]
    shared = correlation(errors)
    summary = {}
    for count in (n for n in COUNTS if n <= config["drapes"]):
        chosen = [k for k, own in enumerate(samples) if len(own) >= count]
        together = [joined([Estimate(s, DIRECTIONS, 0.0, 1.0, REFERENCE_DENSITY, np.ones(6))
                            for s in samples[k][:count]], [str(i) for i in range(count)]).samples
                    if count > 1 else samples[k][0] for k in chosen]
        summary[count] = posterior_errors(truth[chosen], together)
        names = results[f"fabric_{chosen[0]}"]["names"]
        least = [bound(names, fisher[k][:count]) for k in chosen]
        least = np.sqrt(np.nanmean(np.square(least), axis=0))
        summary[count] |= {
            "bound": rms(least[LINEAR]),
            "curl": float(least[-len(CURL_NUISANCES):].mean())}
    return Result({"correlation": shared.tolist(), "summary": summary})
