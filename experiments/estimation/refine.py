"""Refinement of captures and of scans of known fabrics.

Fabrics from the prior are lowered onto the plate on a finer mesh than that of the refinement,
captured, and estimated by the network and by the refinement; both posteriors are compared with the
truth. With ``nuisances=real`` specimens and captures have all nuisances, with ``none`` all but a
random camera pose is exact. Scans are the draped vertices with noise.
"""

import time
from dataclasses import replace
from itertools import compress
from pathlib import Path
from typing import Any, Literal

import numpy as np

from common.cases import load_arrays
from common.configs import read_option
from common.types import Theta
from data.fabrics.fabrics import THETA_NAMES
from data.fabrics.nuisances import NAMES
from data.render.setups import Setups
from drapenet.network.posterior import inside, ranks
from experiments.drapes import (
    CLEAN,
    as_read,
    capture_drape,
    drape_as_planned,
    header,
    plan_specimen,
)
from experiments.report import Report, rms
from experiments.study import CaseKeys, Sample, Study, folder_of, samples_of
from sim.draping import Drape, drape
from sim.material import LINEAR, RATIO, REFERENCE_DENSITY
from sim.measures import fold_angles, fold_outline
from sim.rig import Rig

_MAX_FOLD_SHIFT = 0.25  # of a fold, as a fraction of the mean angle between folds
METHODS = ("network", "search", "refined")


class Keys(CaseKeys):
    captured: Literal["views", "scans"] = "views"
    rig: str = "square300_cylinder100"  # tester
    nuisances: Literal["none", "real"] = "none"  # of specimens and captures
    fabrics: int = 40  # number of fabrics
    edge_mm: float | None = None  # at the rim in the last round; null: default of infer.py
    truth_mm: float = 1.25  # mesh edges at the rim of the captured drape
    noise_mm: float = 0.3  # standard deviation of scanned vertices
    seed: int = 77  # of all random numbers
    workers: int = 2  # processes, one thread each


def refined(
    rng: np.random.Generator, *, captured: str, number: int, rig: str, nuisances: str,
    edge_mm: float | None, truth_mm: float, noise_mm: float, seed: int
) -> Sample:
    """Estimate one capture or scan with the network and with the refinement."""
    from drapenet.fabric.stages import by_network
    from drapenet.refine.refine import refine_capture

    tester = Rig.from_name(rig)
    plan = plan_specimen(number, rig=tester, nuisances=nuisances, seed=seed)
    shape = drape_as_planned(plan, edge=1e-3 * truth_mm)
    found: Sample = {"theta": plan.theta.tolist(), "nuisances": plan.nuisances.vector.tolist()}
    more: dict[str, Any] = {}
    if captured == "scans":
        capture, scan, found["registered_mm"] = scanned(shape, tester, rng, noise_mm)
        more = {"scan": scan}
    else:
        setups = replace(Setups.load("real"), **(CLEAN if nuisances == "none" else {}))
        capture = as_read(capture_drape(shape, setups, rng, tester), tester)
        found["views"] = len(capture.views)
    inferred = by_network(capture, header())
    estimate, began = inferred.estimate, time.perf_counter()
    settings = read_option("refine", "simulation")
    if edge_mm is not None:
        settings["edge_mm"] = edge_mm
    result = refine_capture(inferred.draws.cloth, inferred.observed.views, header(),
                            density=capture.density, warp=capture.warp_direction,
                            settings=settings, **more)
    found["seconds"] = time.perf_counter() - began
    first = drape(estimate.fabric, rig=tester, seed=number)
    outlines = [fold_outline(d.positions, d.rest, tester) for d in (shape, first)]
    samples = {"network": estimate.samples, "search": estimate.samples}
    if result and result.searched:
        theta = slice(len(THETA_NAMES))
        samples["search"] = np.random.default_rng(0).multivariate_normal(
            result.searched.mean[theta], result.searched.covariance[theta, theta],
            size=len(estimate.samples))
    return found | {
        "specimen": result.content["specimen"] if result else {},
        "away_mm": result.content.get("fidelity", {}).get("displacement_mm") if result else None,
        "other_folds": not same_folds(*outlines),
        "gained": bool(result) and result.draws is not None,
        "status": result.content["status"] if result else "none",
        "spread": estimate.spread.tolist(), "arrays": samples}


def scanned(
    shape: Drape, rig: Rig, rng: np.random.Generator, noise_mm: float
) -> tuple[Any, Any, float]:
    """The capture of a noisy scan of a drape, whose x axis is the warp, its registered shape, and
    their distance, mm."""
    from drapenet.surface.registration import EDGE, register, scan_capture
    from drapenet.surface.shape import Cloud

    noise = rng.normal(0, 1e-3 * noise_mm, shape.positions.shape)
    scan = register(Cloud.of_mesh(shape.positions + noise, shape.faces), rig, edge=EDGE)
    return (scan_capture(Path("scan"), scan.shape, REFERENCE_DENSITY, 0.0), scan.shape,
            1e3 * scan.distance)


def with_pool(arrays: dict[str, np.ndarray], *, gained: bool) -> dict[str, np.ndarray]:
    """Samples of a case, and those of the refined estimate."""
    from drapenet.refine.refine import pooled

    network = arrays["network"]
    return arrays | {"refined": pooled(network, arrays["search"]) if gained else network}


def same_folds(outline: np.ndarray, other: np.ndarray) -> bool:
    """Whether two drapes have the same fold configuration.

    They have as many folds, and each is within a quarter of the mean fold spacing of its
    counterpart. ``outline`` and ``other`` (720, 2) are from :func:`sim.measures.fold_outline`.
    """
    folds, others = fold_angles(outline), fold_angles(other)
    if len(folds) != len(others):
        return False
    if not len(folds):
        return True
    # Angles wrap around: a fold near 0 may correspond to the last or the next one of the other.
    shifts = [np.roll(others, k) - folds for k in (-1, 0, 1)]
    gap = min(np.abs((shift + np.pi) % (2 * np.pi) - np.pi).max() for shift in shifts)
    return bool(gap < _MAX_FOLD_SHIFT * 2 * np.pi / len(folds))


def nuisance_errors(results: list[Sample]) -> Report:
    """Root mean square errors and estimated deviations of the natural curvatures, by name.

    In units of their spread over specimens.
    """
    curls, found = ("curl_warp", "curl_weft"), {}
    deviations = np.sqrt(np.diag(header().nuisances.normal(curls)[1]))
    for name, deviation in zip(curls, deviations, strict=True):
        label = f"{name}_per_m"
        rows = [(r["specimen"][label], r["nuisances"][NAMES.index(name)]) for r in results
                if label in r["specimen"]]
        if rows:
            error = np.array([one["median"] - truth for one, truth in rows])
            size = np.array([np.diff(one["interval_68"])[0] / 2 for one, _ in rows])
            found[name] = {kind: rms(values) / deviation
                           for kind, values in (("error", error), ("estimated", size))}
    return found


def posterior_errors(truth: Theta, samples: list[Theta]) -> Report:
    """Errors of posterior means, and coverage of intervals, from samples of each capture."""
    errors = np.stack([s.mean(axis=0) for s in samples]) - truth
    places = np.concatenate([ranks(s[:, None], t[None])
                             for s, t in zip(samples, truth, strict=True)])
    return {"log_alpha": rms(errors[:, LINEAR]),
            "log_alpha_median": float(np.median(np.abs(errors[:, LINEAR]))),
            "log_alpha_worst_fabric": float(np.abs(errors[:, LINEAR]).mean(axis=1).max()),
            "beta_over_alpha_mm": 1e3 * rms(errors[:, RATIO]),
            "inside": inside(places), "fabrics": len(truth)}


def run(keys: Keys) -> Report:
    """Refine all captures."""
    folder = folder_of(keys) / f"{keys.captured}_{keys.nuisances}"
    keys = keys.model_copy(update={"cases": str(folder)})
    results = samples_of(refined, keys, keys.fabrics, kind="views")
    truth = np.array([one["theta"] for one in results.values()])
    arrays = [with_pool(load_arrays(folder, name), gained=one["gained"])
              for name, one in results.items()]
    other = np.array([one["other_folds"] for one in results.values()])
    groups = {"all": np.ones(len(truth), bool), "other folds": other}
    away = [one["away_mm"] for one in results.values() if one["away_mm"] is not None]
    seconds = np.array([one["seconds"] for one in results.values()])
    return {"summary": {
                group: {way: posterior_errors(
                    truth[rows], [each[way] for each in compress(arrays, rows)])
                    for way in METHODS}
                for group, rows in groups.items() if rows.any()},
            "specimen": nuisance_errors(list(results.values())),
            "mean_away_mm": float(np.mean(away)) if away else None,
            "seconds": {"median": float(np.median(seconds)), "largest": float(seconds.max())},
            "cases": results}


STUDY = Study(Keys, run)
