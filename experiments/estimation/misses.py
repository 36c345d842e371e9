"""How far captures lie from the simulated drapes of their estimates, and how often that is named.

Unseen fabrics of evenly distributed stiffness are draped on each tester, as specimens with all
nuisances, and captured in depth views and as an outline under parallel light. Each capture is
estimated, and two drapes of the estimate are simulated as for a report. False alarms are the shares
of these captures that a check names: those of the outline and of :mod:`drapenet.network.expected`,
which cost nothing, and those of the simulated drape. The same outlines with a fault show how many a
check finds: a shadow that is read as cloth over an eighth of the outline, its valleys there filled,
a bite or a bulge of 5 mm over a fiftieth, and a tester of another size.
"""

import math
from typing import Any

import cv2
import numpy as np

from common.command import compose_config
from common.findings import texts
from data.captures.clarity import bulge
from data.dataset.config import Options, config_from_options
from data.dataset.plan import plan_drape
from data.render.setups import Setups
from drapenet.fabric.stages import simulate
from drapenet.report.drape import Resimulation, resimulate_outline
from drapenet.views.directions import AZIMUTH
from drapenet.views.outline import DrapeOutline
from experiments.drapes import (
    LEARNED,
    capture_drape,
    drape_as_planned,
    infer,
    infer_outline,
    outline_of,
)
from experiments.report import Report
from experiments.study import CaseKeys, Sample, Study, samples_of
from sim.outlines import closed, farthest
from sim.rig import Rig

SHADOW = math.pi / 8  # half of the azimuths that it covers
DARKEST = (0.95, 1.05)  # radius of its edge, over the drape's largest
FAULT = math.pi / 50, 5e-3  # half of the azimuths of a bite or a bulge, and its height in m
MOVED = 1.15  # factor of alpha, in the median over its directions, that counts as a wrong estimate
OTHER = {"disc240_support180": "disc300_support180", "disc300_support180": "disc360_support180",
         "disc360_support180": "disc300_support180",
         "square300_cylinder100": "square350_cylinder120"}
"""A tester that might be stated in place of each."""
KINDS = ("depth views", "outline", "shadow", "filled valleys", "bite", "bulge", "other tester")


class Keys(CaseKeys):
    testers: tuple[str, ...] = tuple(OTHER)
    fabrics: int = 40  # of each tester
    seed: int = 12  # of fabrics, specimens and captures
    edge_mm: float = 5.0  # edges of the meshes at the plate's rim


def captured(rng: np.random.Generator, *, tester: str, number: int, seed: int,
             edge_mm: float) -> Sample:
    """Deviations and checks of both captures of a drape, and of the faulty outlines."""
    config = config_from_options(compose_config("generate", [
        *LEARNED, "dataset.even_share=1", f"dataset.testers=[{tester}]", f"seed={seed}"],
        schema=Options))
    plan = plan_drape(number, config=config.sampling, prior=config.prior)
    shape = drape_as_planned(plan, edge=1e-3 * edge_mm)
    views = simulate(infer(capture_drape(shape, Setups.load("real"), rng, plan.rig), plan.rig),
                     drapes=2, edge=4e-3)
    seen = views.observed.seen.outline
    found = {}
    if views.drape and seen:
        found["depth views"] = _compared(views.drape, seen.coefficient(plan.rig)) | {
            "unlike": texts(views.draws.unlike(plan.rig.specimen_size, views.capture.causes))}
    radius = outline_of(shape).radius
    middle = rng.uniform(0, 2 * np.pi)
    away = np.abs(np.angle(np.exp(1j * (AZIMUTH - middle))))
    dark, fault = away < SHADOW, np.where(away < FAULT[0], FAULT[1], 0.0)
    edge = radius.max() * rng.uniform(*DARKEST)
    found |= {"outline": _outline(radius, plan.rig),
              "shadow": _outline(np.where(dark, np.maximum(radius, edge), radius), plan.rig),
              "filled valleys": _outline(np.where(dark, _filled(radius), radius), plan.rig),
              "bite": _outline(radius - fault, plan.rig),
              "bulge": _outline(radius + fault, plan.rig),
              "other tester": _outline(radius, Rig.from_name(OTHER[tester]))}
    sound = np.array(found["outline"]["log_alpha"])
    for one in found.values():
        if "log_alpha" in one:
            one["moved"] = float(np.exp(np.median(np.abs(one.pop("log_alpha") - sound))))
    return found


def _filled(radius: np.ndarray) -> np.ndarray:
    """Radii (A,) of an outline without valleys: of its convex hull."""
    angle = AZIMUTH - AZIMUTH[0]
    points = radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    hull = cv2.convexHull(points.astype(np.float32))[:, 0]
    return np.maximum(farthest(closed(hull), len(radius)), radius)


def _outline(radius: np.ndarray, rig: Rig) -> dict[str, Any]:
    outline = DrapeOutline(radius)
    _, estimate, unlike = infer_outline(outline, rig)
    drape = resimulate_outline(estimate.fabric, outline, rig, edge=4e-3, drapes=2,
                               laws=estimate.nuisances.laws)
    compared = _compared(drape, outline.coefficient(rig)) if drape else {}
    alpha = np.log(estimate.fabric.alpha).tolist()
    return compared | {"unlike": texts([*bulge(radius), *unlike]), "log_alpha": alpha,
                       "extrapolated": bool(estimate.warnings)}


def _compared(drape: Resimulation, coefficient: float) -> dict[str, Any]:
    folds = drape.folds
    return {"gap": drape.coefficient - coefficient, "overlap": drape.overlap,
            "folds": None if None in folds else folds[1] - folds[0],  # type: ignore[operator]
            "named": bool(drape.warnings(coefficient))}


def run(keys: Keys) -> Report:
    """Compare all captures."""
    results = samples_of(captured, keys, {
        f"{tester}_{k:03}": {"tester": tester, "number": 8 * k}
        for tester in keys.testers for k in range(keys.fabrics)})
    return {"summary": {kind: _summary([found[kind] for found in results.values()
                                        if kind in found]) for kind in KINDS},
            "captures": results}


def _summary(found: list[Sample]) -> Report:
    draped = [one for one in found if "gap" in one]
    gaps = np.abs([one["gap"] for one in draped])
    unlike, named = (np.array([bool(test(one)) for one in found]) for test in (
        lambda one: any(one["unlike"]), lambda one: one.get("named")))
    factors = np.array([one.get("moved", 1.0) for one in found])
    moved = factors > MOVED
    return {"captures": len(found), "unlike": float(unlike.mean()), "named": float(named.mean()),
            "either": float((unlike | named).mean()),
            "moved_by": (np.quantile(factors, [0.5, 0.9]) - 1).tolist(),
            "moved": [int(moved.sum()), int((moved & ~unlike & ~named).sum())],
            "gap": np.quantile(gaps, [0.5, 0.9, 0.99]).tolist(),
            "overlap": np.quantile([one["overlap"] for one in draped], [0.5, 0.1, 0.01]).tolist()}


STUDY = Study(Keys, run)
