"""What a fabric's stretch and shear stiffness, if they were known, would add to one drape.

Fabrics, specimens and errors of captures are those of the experiment ``bounds``, one drape each.
For the best possible estimate, the smallest standard deviation of log alpha and of the logarithm of
the stiffness in a drape is calculated with both unknown, as they are for the network; measured,
with the errors assumed of them; and known exactly. For the network, the drape is moved, in linear
approximation, as by a membrane stiffness or a shear ratio that is one standard deviation of the
training larger: the mean square by which its estimates change is the part of their squared error
that such knowledge could remove.
"""

from dataclasses import replace
from typing import Any

import numpy as np

from common.types import Theta
from data.dataset.plan import DrapePlan, plan_drape
from data.fabrics.fabrics import from_theta
from data.fabrics.nuisances import LOGARITHMIC
from data.fabrics.prior import load_prior
from data.readings import QUANTITIES
from data.render.setups import Setups
from drapenet.measured.tension.posterior import KES_SHEAR_ERROR
from experiments.drapes import capture_drape, infer, infer_outline, outline_of
from experiments.estimation.bound import Information, drape_moves
from experiments.estimation.bounds import DRAPES, draped, information_of, placement, sampling_of
from experiments.result import Config, Result, rms, run_cases
from sim.draping import Drape
from sim.material import DRAPE_CURVATURE, secant
from sim.sensitivity import Tangent
from sim.solver.state import State

MEASURED = {"stretch": QUANTITIES["membrane_n_per_m"].error, "shear": KES_SHEAR_ERROR}
"""Errors of the logarithms."""
EXACT = 1e-4
KNOWN: dict[str, dict[str, float]] = {
    "unknown": {}, "stretch measured": {"stretch": MEASURED["stretch"]},
    "shear measured": {"shear": MEASURED["shear"]}, "both measured": MEASURED,
    "both exact": dict.fromkeys(MEASURED, EXACT)}
_OF = {"stretch": (1.0, 0.0), "shear": (1.0, 1.0)}
"""Of the logarithms of the membrane stiffness and of the shear ratio."""
PARTS = {"log_alpha": slice(0, 3), "log_drape_stiffness": slice(3, 6)}
_STEP = 1e-4  # of theta, in its prior deviations


def logarithms(theta: Theta) -> np.ndarray:
    """(..., 6) log alpha and log stiffness in a drape."""
    alpha, beta = from_theta(theta)
    return np.concatenate([np.log(alpha), np.log(secant(DRAPE_CURVATURE, alpha, beta))], axis=-1)


def with_known(found: Information, errors: dict[str, float]) -> Information:
    """With stretch or shear known, with errors of their logarithms."""
    columns = [found.names.index(name) for name in LOGARITHMIC]
    rows = np.zeros((len(errors), len(found.names)))
    for row, (name, error) in zip(rows, errors.items(), strict=True):
        row[columns] = np.array(_OF[name]) / error
    return replace(found, fisher=found.fisher + rows.T @ rows)


def fabric_case(*, tester: str, fabric: int, seed: int, edge_mm: float) -> dict[str, Any]:
    """Standard deviations (6,) of :func:`logarithms` by input and row, the network's error, and
    how far it moves with each nuisance; nothing of a drape without derivatives."""
    config, prior = sampling_of(tester, seed), load_prior("gaussian")
    plan = plan_drape(DRAPES * fabric, config=config, prior=load_prior("vae"))
    shape, deviations = draped(plan, 1e-3 * edge_mm), config.nuisances.deviations
    found = information_of(plan, shape)
    if not all(one.ok for one in found.values()):
        return {}
    steps = _STEP * np.diag(prior.deviation)
    slopes = (logarithms(plan.theta + steps) - logarithms(plan.theta - steps)).T / (
        2 * np.diag(steps))
    places = placement(config, plan.rig)
    ideal = {kind: {name: np.sqrt(np.diag(slopes @ with_known(one, known).posterior(
        prior.covariance, deviations | places[kind]) @ slopes.T)).tolist()
        for name, known in KNOWN.items()} for kind, one in found.items()}
    moves = drape_moves(Tangent.of(shape), shape, plan.nuisances)
    moved = {name: replace(shape, state=State.at(
        shape.mesh, shape.positions + deviations[name] * moves[name])) for name in LOGARITHMIC}
    here = _estimated(plan, shape)
    there = {name: _estimated(plan, one) for name, one in moved.items()}
    return {kind: {"ideal": ideal[kind], "network": {
        "error": (here[kind] - logarithms(plan.theta)).tolist(),
        **{name: (one[kind] - here[kind]).tolist() for name, one in there.items()}}}
        for kind in found}


def _estimated(plan: DrapePlan, shape: Drape) -> dict[str, np.ndarray]:
    """The network's mean of :func:`logarithms` from each input, with the same errors for each
    shape."""
    setups = replace(Setups.load("real"), views=(0.0, 0.0, 0.0, 1.0))
    rng = np.random.default_rng([plan.seed, plan.fabric])
    depth = infer(capture_drape(shape, setups, rng, plan.rig), plan.rig).estimate
    outline = infer_outline(outline_of(shape), plan.rig)[1]
    return {kind: logarithms(estimate.samples).mean(axis=0)
            for kind, estimate in (("depth", depth), ("outline", outline))}


def run(config: Config) -> Result:
    """All fabrics on all testers."""
    cases = {f"{tester}_{k:02}": {"tester": tester, "fabric": k, "seed": config["seed"],
                                  "edge_mm": config["edge_mm"]}
             for tester in config["testers"] for k in range(config["fabrics"])}
    found = run_cases(fabric_case, cases, config)
    cells: dict[str, dict] = {}
    for tester in config["testers"]:
        good = [one for name, one in found.items() if cases[name]["tester"] == tester and one]
        cells[tester] = {kind: summary([one[kind] for one in good]) | {"fabrics": len(good)}
                         for kind in (good[0] if good else ())}
    return Result({"measured": MEASURED, "cells": cells})


def summary(cases: list[dict]) -> dict[str, dict[str, dict[str, float]]]:
    """Root mean squares over fabrics and directions."""
    return {part: {name: {quantity: rms(np.array([case[part][name] for case in cases])[:, columns])
                          for quantity, columns in PARTS.items()} for name in cases[0][part]}
            for part in ("ideal", "network")}
