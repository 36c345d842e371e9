"""Estimates from several drapes of one fabric.

Each fabric from the prior is draped several times, with another specimen, start and capture each
time. The network estimates it from the first 1, 2, ... of these captures together. The bound
(:mod:`experiments.estimation.bound`) is computed for the same drapes, also for the curvature. It
does not fall as for independent errors, because drapes of one fabric share membrane, hysteresis and
natural curvature.
"""

import math
from pathlib import Path

import numpy as np

from common.errors import InputError
from data.fabrics.prior import load_prior
from data.render.cameras import nominal_camera
from data.render.setups import Setups
from drapenet.views.located import LocatedViews
from drapenet.views.observation import Observation
from experiments.drapes import as_read, capture_drape, drape_as_planned, header, plan_specimen
from experiments.estimation.bound import CAMERA, SETUP, SPECIMEN, Information, joint_covariance
from experiments.estimation.refine_views import posterior_errors
from experiments.result import ESTIMATOR, Config, Result, load_arrays, rms, run_cases
from sim.material import LINEAR
from sim.rig import Rig

COUNTS = (1, 2, 5)
CURL_NUISANCES = ("curl_warp", "curl_weft")
CLOTH_NUISANCES = ("membrane", "shear", "hysteresis", *CURL_NUISANCES)
"""Nuisances of the fabric; the others are of the specimen."""


def case(*, number: int, rig: str, drapes: int, truth_mm: float, seed: int) -> dict:
    """Estimate one fabric from the first of its drapes, by their number; samples along the warp."""
    from drapenet.inference import network_of
    from drapenet.network.predict import predict
    from experiments.estimation.bound import depth_information

    tester, setups = Rig.from_name(rig), Setups.load("real")
    seen, arrays = [], {}
    for index in range(number * drapes, (number + 1) * drapes):
        plan = plan_specimen(index, f"dataset.starts_per_fabric={drapes}", rig=tester,
                             nuisances="real", seed=seed)
        try:
            shape = drape_as_planned(plan, edge=1e-3 * truth_mm)
        except InputError:  # it does not converge
            continue
        synthetic = capture_drape(shape, setups, np.random.default_rng([seed, index]), tester)
        capture = as_read(synthetic, tester)
        seen.append(Observation.of_views(LocatedViews.of(capture), capture.sign,
                                         capture.warp_direction))
        found = depth_information(shape, nominal_camera(tester), nuisances=plan.nuisances,
                                  orientation=synthetic.orientation)
        arrays[f"fisher_{index}"] = found.fisher
    counts = [count for count in COUNTS if count <= len(seen)]
    draws = predict(network_of(header()), header(), [seen[:count] for count in counts])
    arrays |= {f"samples_{count}": one.cloth.theta
               for count, one in zip(counts, draws, strict=True)}
    return {"theta": plan.theta.tolist(), "names": found.names, "arrays": arrays}


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


def run(config: Config) -> Result:
    """Estimate all fabrics."""
    settings = {key: config[key] for key in ("rig", "drapes", "truth_mm", "seed")}
    folder = Path(config["cases"])
    results = run_cases(case, {f"fabric_{k}": {"number": k, **settings}
                               for k in range(config["fabrics"])},
                        config, folder=folder, sources=ESTIMATOR)
    arrays = {name: load_arrays(folder, name) for name in results}
    summary = {}
    for count in (n for n in COUNTS if n <= config["drapes"]):
        samples = {name: own[f"samples_{count}"] for name, own in arrays.items()
                   if f"samples_{count}" in own}
        truth = np.array([results[name]["theta"] for name in samples])
        least = [bound(results[name]["names"], [arrays[name][key] for key in arrays[name]
                                                if key.startswith("fisher")][:count])
                 for name in samples]
        least = np.sqrt(np.nanmean(np.square(least), axis=0))
        summary[count] = posterior_errors(truth, list(samples.values())) | {
            "bound": rms(least[LINEAR]),
            "curl": float(least[-len(CURL_NUISANCES):].mean())}
    return Result({"summary": summary})
