"""Fabrics chosen by hand, limp, stiff and with different yarns: estimates, intervals and warnings.

Each fabric is draped once on each tester, as a specimen with all nuisances, and estimated from four
depth views and from its outline under parallel light. Counted are the directions whose true alpha
lies outside the 99 % interval, and the estimates with such directions that have no warning.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from common.findings import Finding, texts
from data.fabrics.fabrics import to_theta
from data.render.setups import Setups
from data.rigs import named_tester
from drapenet.network.predict import Draws
from experiments.drapes import (
    capture_drape,
    drape_as_planned,
    infer,
    infer_outline,
    outline_of,
    plan_specimen,
)
from experiments.report import Report, read_rows
from experiments.study import CaseKeys, Sample, Study, samples_of
from sim.material import DIRECTIONS, LINEAR, MICRO, NANO, REFERENCE_DENSITY, is_admissible
from sim.measures import drape_coefficient


class Keys(CaseKeys):
    fabrics: str = "experiments/estimation/hard_fabrics.csv"
    testers: tuple[str, ...] = (
        "disc300_support180", "disc360_support180", "square300_cylinder100")
    seed: int = 8  # of the specimens and captures
    edge_mm: float = 5.0  # edges of the meshes at the plate's rim


def read_fabrics(path: str) -> dict[str, list[float]]:
    """Theta of fabrics at 300 g/m² by name."""
    found = {}
    for row in read_rows(path):
        scale = 1e3 * REFERENCE_DENSITY / float(row["weight"])
        alpha, beta = (scale * unit * np.array([float(row[f"{name}_{d}"]) for d in DIRECTIONS])
                       for name, unit in (("alpha", MICRO), ("beta", NANO)))
        assert is_admissible(alpha, beta), f"no plate has the moduli of {row['name']}"
        found[row["name"]] = to_theta(alpha, beta).tolist()
    return found


def estimated(rng: np.random.Generator, *, theta: list[float], tester: str, number: int,
              seed: int, edge_mm: float) -> Sample:
    """Both estimates of a drape of a fabric."""
    rig = named_tester(tester)
    plan = replace(plan_specimen(number, "dataset=testers", "dataset.rectangles=0",
                                 "dataset.random_testers=0", "dataset.rounded_rims=0", seed=seed,
                                 nuisances="real", rig=rig),
                   theta=np.array(theta))
    shape = drape_as_planned(plan, edge=1e-3 * edge_mm)
    setups = replace(Setups.load("real"), views=(0.0, 0.0, 0.0, 1.0))
    views = infer(capture_drape(shape, setups, rng, rig), rig)
    draws, estimate, unlike = infer_outline(outline_of(shape), rig)
    return {"coefficient": drape_coefficient(shape.positions, shape.faces, rig),
            "depth": _judged(views.draws, theta, views.document.warnings),
            "outline": _judged(draws, theta, [*estimate.warnings, *unlike])}


def _judged(draws: Draws, theta: list[float], warnings: Sequence[Finding]) -> dict[str, Any]:
    samples, true = draws.cloth.theta[:, LINEAR], np.array(theta)[LINEAR]
    low, high = np.quantile(samples, [0.005, 0.995], axis=0)
    return {"error": (samples.mean(axis=0) - true).tolist(),
            "outside": int(((true < low) | (true > high)).sum()), "warnings": texts(warnings)}


def run(keys: Keys) -> Report:
    """Drape and estimate all fabrics."""
    results = samples_of(estimated, keys, {
        f"{name}, {tester}": {"theta": theta, "tester": tester, "number": number}
        for number, (name, theta) in enumerate(read_fabrics(keys.fabrics).items())
        for tester in keys.testers})
    summary = {}
    for kind in ("depth", "outline"):
        found = {label: result[kind] for label, result in results.items()}
        errors = np.abs([one["error"] for one in found.values()])
        missed = [label for label, one in found.items() if one["outside"]]
        summary[kind] = {
            "estimates": len(found), "directions_outside": sum(
                one["outside"] for one in found.values()), "missed": missed,
            "in_silence": [label for label in missed if not found[label]["warnings"]],
            "with_a_warning": sum(bool(one["warnings"]) for one in found.values()),
            "median": float(np.expm1(np.median(errors))),
            "ninth_decile": float(np.expm1(np.quantile(errors, 0.9)))}
    return {"summary": summary, "fabrics": results}


STUDY = Study(Keys, run)
