"""Posterior bounds for each tester and input of ``make evaluate``.

Fabrics, testers, specimens and faces are drawn as for the evaluation; each fabric has four lowered
drapes. A bound is the root mean square, over fabrics and directions, of the smallest standard
deviation of an estimate that uses the prior of moduli and nuisances (the experiment
``information``), over the spread. The errors of an outline are those of training pictures under
parallel light, with one radius in three as an independent measurement. In sets, fabric, membrane,
shear and hysteresis are common to all captures.
"""

import numpy as np

from common.command import compose_config
from common.types import Metres
from data.dataset.config import Options, SamplingConfig, config_from_options
from data.dataset.plan import DrapePlan, plan_drape
from data.fabrics.fabrics import THETA_NAMES, fabric_from_theta
from data.fabrics.nuisances import NAMES
from data.fabrics.prior import load_prior
from data.fabrics.prior.even import spread_of
from data.render.cameras import nominal_camera
from drapenet.network.captures import PICTURE_NOISE, PICTURE_OFFSET, PICTURE_SCALE
from drapenet.network.dataset import DIRECTION_ERROR
from experiments.drapes import LEARNED
from experiments.estimation.bound import (
    CAMERA,
    PICTURE,
    SPECIMEN,
    Information,
    depth_information,
    joint_covariance,
    outline_information,
)
from experiments.result import Config, Result, rms, run_cases
from sim.draping import Drape, drape
from sim.rig import Rig

SHARED = ("membrane", "shear", "hysteresis")
DRAPES = 4
SETS = (1, 2, DRAPES)
INPUTS = {"depth": "4 views", "outline": "parallel light"}


def sampling_of(tester: str, seed: int) -> SamplingConfig:
    """Sampling of fabrics and specimens on a ``tester``."""
    words = [*LEARNED, f"dataset.testers=[{tester}]", "dataset.testers_per_fabric=1",
             f"dataset.starts_per_fabric={DRAPES}", f"seed={seed}"]
    return config_from_options(compose_config("generate", words, schema=Options)).sampling


def cell_name(kind: str, captures: int) -> str:
    """Name of a cell of the evaluation."""
    return f"{kind}, {INPUTS[kind] if captures == 1 else f'sets of {captures}'}"


def draped(plan: DrapePlan, edge: Metres) -> Drape:
    """The drape of a plan, with mesh edges of ``edge`` at the plate's rim."""
    return drape(fabric_from_theta(plan.theta), rig=plan.nuisances.rig(plan.rig), edge=edge,
                 start=plan.start, seed=plan.seed, offset=tuple(plan.offset),
                 laws=plan.nuisances.laws)


def information_of(plan: DrapePlan, shape: Drape) -> dict[str, Information]:
    """Of a drape, by input."""
    return {"depth": depth_information(shape, nominal_camera(), nuisances=plan.nuisances),
            # Deviations of training pictures are uniform up to the largest.
            "outline": outline_information(
                shape, nuisances=plan.nuisances, cells_per_measurement=3,
                noise=PICTURE_NOISE / 3**0.5 * plan.rig.specimen_size / 2)}


def placement(config: SamplingConfig, rig: Rig) -> dict[str, dict[str, float]]:
    """Standard deviations, by input, of where a specimen lies and is seen from."""
    drift, half = dict.fromkeys(SPECIMEN[1:], config.drift), rig.specimen_size / 2
    return {"depth": drift | dict.fromkeys((SPECIMEN[0], *CAMERA), np.inf),
            "outline": drift | dict(zip((SPECIMEN[0], *PICTURE), (
                DIRECTION_ERROR, PICTURE_OFFSET * half, PICTURE_OFFSET * half, PICTURE_SCALE),
                strict=True))}


def bounds_of_fabric(
    *, tester: str, fabric: int, seed: int, edge_mm: float
) -> dict[str, list]:
    """Smallest standard deviations (6,) of theta by cell; none where a drape has no derivatives."""
    config, prior = sampling_of(tester, seed), load_prior("gaussian").covariance
    plans = [plan_drape(index, config=config, prior=load_prior("vae"))
             for index in range(DRAPES * fabric, DRAPES * (fabric + 1))]
    drapes = [information_of(plan, draped(plan, 1e-3 * edge_mm)) for plan in plans]
    captures = {kind: [one[kind] for one in drapes] for kind in INPUTS}
    deviations = config.nuisances.deviations
    common = {name: deviations[name] for name in SHARED}
    single = {name: deviations[name] for name in NAMES if name not in SHARED}
    separate = {kind: single | place for kind, place in placement(config, plans[0].rig).items()}
    found = {}
    for kind, parts in captures.items():
        good = [part for part in parts if part.ok]
        for count in SETS:
            if len(good) >= count:
                covariance = joint_covariance(good[:count], np.linalg.inv(prior),
                                              separate=separate[kind], shared=common)
                found[cell_name(kind, count)] = np.sqrt(np.diag(covariance)[:6]).tolist()
    return found


def run(config: Config) -> Result:
    """Compute the bounds."""
    cases = {f"{tester}_{k:02}": {"tester": tester, "fabric": k, "seed": config["seed"],
                                  "edge_mm": config["edge_mm"]}
             for tester in config["testers"] for k in range(config["fabrics"])}
    results = run_cases(bounds_of_fabric, cases, config)
    spread = spread_of(load_prior("vae"))
    cells: dict[str, dict] = {}
    for tester in config["testers"]:
        cells[tester] = {}
        for name in (cell_name(kind, count) for kind in INPUTS for count in SETS):
            values = np.array([found[name] for label, found in results.items()
                               if name in found and cases[label]["tester"] == tester]) / spread
            if len(values):
                cells[tester][name] = {"log_alpha": rms(values[:, :3]),
                                       "beta_over_alpha": rms(values[:, 3:]),
                                       "fabrics": len(values)}
    return Result({"parameters": THETA_NAMES, "cells": cells})
