"""Biases of estimates by the meshes of the drapes, against a fine mesh.

Fabrics of evenly spaced stiffness are lowered from the same start on meshes of several edge
lengths. The network reads their outlines under parallel light and four ideal depth views; its own
error is common to the meshes and cancels in pairs of estimates. A network trained on drapes of a
coarse mesh has the opposite bias for drapes of a fine one. Folds form on a mesh common to all, but
where they differ, or several minima are near, pairs have random differences besides the bias.
"""

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np

from common.errors import InputError
from data.fabrics.prior import load_prior, log_stiffness
from data.fabrics.prior.even import moved
from experiments.drapes import as_read, capture_drape, drape_as_planned, ideal_setups, plan_specimen
from experiments.result import ESTIMATOR, Config, Result, rms, run_cases
from sim.drape import Drape
from sim.material import LINEAR, MICRO, bending_length
from sim.measures import drape_coefficient, fold_count
from sim.rig import Rig

KINDS = ("outline", "views")
TOGETHER = "all captures"  # of a fabric, on all testers, in one set
CLASSES = 3  # of stiffness, with equal numbers of fabrics
OUTLIER = 2.0  # posterior deviations by which a drape with the same folds differs


def run_case(
    *, number: int, alpha_uN_m: float, testers: list[str], edges_mm: list[float], seed: int,
    checkpoint: str,
) -> dict[str, Any]:
    """Drapes of one fabric on all testers and meshes, and their estimates."""
    from drapenet.estimator.infer import network_of
    from drapenet.network.checkpoint import read_header
    from drapenet.network.predict import predict

    header = read_header(checkpoint)
    rows, seen, names = [], [], []
    for edge in edges_mm:
        together = []
        for tester in testers:
            row: dict[str, Any] = {"tester": tester, "edge_mm": edge}
            rows.append(row)
            rig = Rig.from_name(tester)
            plan = plan_specimen(number, seed=seed, nuisances="real", rig=rig)
            shift = np.log(alpha_uN_m * MICRO) - log_stiffness(plan.theta)
            plan = replace(plan, theta=moved(plan.theta, float(shift), load_prior("vae").softening))
            try:
                shape = drape_as_planned(plan, edge=1e-3 * edge)
            except InputError:
                continue
            row |= {"coefficient": drape_coefficient(shape.positions, shape.faces, shape.rig),
                    "folds": fold_count(shape.positions, shape.rest, shape.rig),
                    "length_mm": 1e3 * bending_length(shape.fabric.alpha.min(),
                                                      shape.fabric.density)}
            for kind, observation in observed(shape, rig, plan.face, number).items():
                seen.append([observation])
                names.append((row, kind))
                together.append(observation)
        if len(together) == len(KINDS) * len(testers):
            seen.append(together)
            names.append((rows[-1], TOGETHER))
    for (row, kind), draws in zip(names, predict(network_of(header), header, seen), strict=True):
        log_alpha = draws.cloth.theta[:, LINEAR]
        middle = log_alpha.mean(axis=1)
        row[kind] = [float(middle.mean()), float(middle.std()), rms(log_alpha.std(axis=0))]
    return {"alpha_uN_m": alpha_uN_m, "drapes": rows}


def observed(shape: Drape, rig: Rig, face: int, seed: int) -> dict[str, Any]:
    """What the network reads of a drape on the nominal ``rig``, by :data:`KINDS`."""
    from drapenet.views.located import LocatedViews
    from drapenet.views.observation import Observation
    from drapenet.views.outline import DrapeOutline, contour, silhouettes

    border = contour(shape.positions, shape.mesh, np.inf)
    radius, = silhouettes(shape.positions, border, np.array([np.inf]), zero=0.0)
    capture = as_read(capture_drape(shape, ideal_setups(), np.random.default_rng(seed), rig), rig)
    return {"outline": Observation(rig, face, True, outline=DrapeOutline(radius)),
            "views": Observation.of_views(LocatedViews.of(capture), face, capture.warp_direction)}


def pairs(found: list[dict], tester: str, edge: float, finest: float) -> list[dict[str, Any]]:
    """Drapes on two meshes, of each fabric: differences of drape coefficient, points, and of the
    means of mean log alpha, with the deviations of the posteriors on the finest mesh."""
    rows = []
    for fabric in found:
        coarse, fine = (next(row for row in fabric["drapes"] if row["tester"] == tester
                             and row["edge_mm"] == mm) for mm in (edge, finest))
        if "folds" not in coarse or "folds" not in fine:
            continue
        row = {"alpha_uN_m": fabric["alpha_uN_m"], "same_folds": coarse["folds"] == fine["folds"],
               "folds": coarse["folds"] - fine["folds"],
               "membrane_N_per_m": fabric["membrane_N_per_m"],
               "coefficient": 100 * (coarse["coefficient"] - fine["coefficient"])}
        rows.append(row | {kind: [coarse[kind][0] - fine[kind][0], *fine[kind][1:]]
                           for kind in (*KINDS, TOGETHER) if kind in coarse and kind in fine})
    return rows


def mean_and_error(values: np.ndarray) -> list[float]:
    """The mean and its standard error."""
    return [float(values.mean()), float(values.std(ddof=1) / np.sqrt(len(values)))]


def summarise(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Bias, with its standard error, and root mean square of the differences of ``rows``: of log
    alpha as such and in deviations of the posterior of its mean over directions; ``of_single``:
    the bias in root mean square deviations of warp, bias and weft."""
    if len(rows) < 2:
        return {"pairs": len(rows)}
    summary: dict[str, Any] = {"pairs": len(rows),
                               "same_folds": sum(row["same_folds"] for row in rows),
                               "folds": mean_and_error(np.array([row["folds"] for row in rows])),
                               "coefficient": mean_and_error(
                                   np.array([row["coefficient"] for row in rows]))}
    for kind in (*KINDS, TOGETHER):
        read = np.array([row[kind] for row in rows if kind in row])
        if len(read) < 2:
            continue
        shift, deviation, single = read.T
        relative = shift / deviation
        summary[kind] = {
            "log_alpha": mean_and_error(shift), "deviation": rms(deviation),
            "bias": mean_and_error(relative), "rms": rms(relative),
            "of_single": mean_and_error(shift / single),
            "far": int((np.abs(relative) > OUTLIER).sum())}
    return summary


def fitted(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Bias of log alpha, the mean of both :data:`KINDS`, as a linear function of the logarithms of
    alpha and membrane stiffness: at their means, slopes, each with its standard error, and the root
    mean square of what remains."""
    rows = [row for row in rows if all(kind in row for kind in KINDS)]
    known = np.log([[row["alpha_uN_m"], row["membrane_N_per_m"]] for row in rows])
    if len(rows) <= known.shape[1] + 1:
        return {"pairs": len(rows)}
    terms = np.column_stack([np.ones(len(rows)), known - known.mean(axis=0)])
    shift = np.array([np.mean([row[kind][0] for kind in KINDS]) for row in rows])
    found = np.linalg.lstsq(terms, shift, rcond=None)[0]
    rest = shift - terms @ found
    variance = rest @ rest / (len(rows) - terms.shape[1])
    error = np.sqrt(variance * np.diag(np.linalg.inv(terms.T @ terms)))
    values = [[float(value), float(of)] for value, of in zip(found, error, strict=True)]
    return {"pairs": len(rows), **dict(zip(("mean", "by_log_alpha", "by_log_membrane"), values,
                                           strict=True)), "remaining": float(np.sqrt(variance))}


def run(config: Config) -> Result:
    """Drape and estimate all fabrics."""
    softest, stiffest = config["alphas_uN_m"]
    alphas = np.geomspace(softest, stiffest, config["fabrics"])
    settings = {key: config[key] for key in ("testers", "edges_mm", "seed", "checkpoint")}
    cases = {f"fabric_{k:02}": settings | {"number": k, "alpha_uN_m": round(float(alpha), 3)}
             for k, alpha in enumerate(alphas)}
    found = list(run_cases(run_case, cases, config, sources=ESTIMATOR).values())
    for number, fabric in enumerate(found):
        plan = plan_specimen(number, seed=config["seed"], nuisances="real")
        fabric["membrane_N_per_m"] = plan.nuisances.membrane
    finest, *others = config["edges_mm"]
    limits = np.geomspace(softest, stiffest, CLASSES + 1)
    report: dict[str, Any] = {}
    for tester in config["testers"]:
        report[tester] = {}
        for edge in others:
            rows = pairs(found, tester, edge, finest)
            by_class = {f"{low:.3g} to {high:.3g}": summarise(
                [row for row in rows if low * 0.999 <= row["alpha_uN_m"] < high * 1.001])
                for low, high in pairwise(limits)}
            report[tester][f"{edge:g}"] = {
                "all": summarise(rows),
                "same folds": summarise([row for row in rows if row["same_folds"]]),
                "fit": fitted([row for row in rows if row["same_folds"]]),
                "by_alpha_uN_m": by_class}
    return Result({"finest_mm": finest, "testers": report})
