"""``python infer.py capture=DIR refine=depth``: the network's estimate, corrected by simulation."""

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from tqdm import tqdm

from data.cameras import Camera
from data.fabrics import from_theta
from drapenet.convention import FIRST, SECOND, STIFF_SOFT, SWAPPED
from drapenet.estimate import Estimate
from drapenet.refine.objective import fit_nuisances
from drapenet.refine.views import FREE_ROUNDS, HELD_ROUNDS, SPREAD, RefinedViews, refine_views
from drapenet.registration import count_folds, radius_profile, silhouette_overlap
from drapenet.resimulate import PROFILE_HEIGHT, Resimulation
from sim.material import MICRO, is_admissible
from sim.scene import Rig

_DRAWS = 4000  # samples of the refined moduli


@dataclass(frozen=True)
class RefinedEstimate:
    """What the refinement of one capture came to.

    Attributes:
        estimate: the corrected one; its stiff axis is the specimen's as it was found.
        content: parts of ``estimate.json`` beside it.
        resimulation: the refined drape beside the capture.
    """

    estimate: Estimate
    content: dict[str, Any]
    resimulation: Resimulation


def refine_capture(
    estimate: Estimate,
    views: np.ndarray,
    camera: Camera,
    *,
    rig: Rig,
    edge: float,
) -> RefinedEstimate | None:
    """Refine the network's estimate until its drape looks like the views, with a progress bar.

    Interrupted from the keyboard, the best so far is handed back. None if no drape converges.

    Args:
        estimate: its first yarns lie along the x axis of the specimen; its samples count as a
            measurement of theta.
        views: (4, H, W) z-depth, m, as ``camera`` saw them.
        edge: m, at the rim of the specimen's mesh in the last round.
    """
    turns = [estimate.axis]
    # Each round comes with a shape and up to two simulations of its own.
    total = (sum(FREE_ROUNDS) + sum(3 + evaluations for evaluations, _ in HELD_ROUNDS)
             + (len(SPREAD) + 1) * len(turns) + 3)
    with tqdm(total=total, desc="refining", unit="sim", leave=False) as bar:
        def progress(simulations: int, value: float) -> None:
            bar.update(simulations - bar.n)
            bar.set_postfix(misfit=f"{value:.0f}")

        refined = refine_views(views, camera, estimate.theta, turns=turns, rig=rig, edge=edge,
                               prior=estimate.normal, progress=progress)
    if refined is None:
        return None
    corrected = _corrected(estimate, refined)
    return RefinedEstimate(corrected, _content(estimate, corrected, refined),
                           _resimulation(views, refined))


def _corrected(estimate: Estimate, refined: RefinedViews) -> Estimate:
    """The estimate with the moduli found, and their uncertainty where there is one."""
    theta, turn = refined.best.theta, float(refined.best.nuisance[0])
    warnings, covariance = estimate.warnings, estimate.normal.covariance
    if refined.uncertainty is None:
        warnings += ("the refinement gives no uncertainty: the network's stands",)
    else:
        covariance = refined.uncertainty.covariance[:6, :6]
    names, certainty = estimate.names, estimate.certainty
    if names == STIFF_SOFT and theta[FIRST] < theta[SECOND]:
        theta, covariance = theta[SWAPPED], covariance[np.ix_(SWAPPED, SWAPPED)]
        turn, certainty = turn + math.pi / 2, 1 - certainty
    draws = np.random.default_rng(0).multivariate_normal(theta, covariance, size=_DRAWS)
    possible = is_admissible(*from_theta(draws))
    return replace(estimate, samples=draws[possible] if possible.any() else theta[None],
                   axis=turn % math.pi, certainty=certainty, warnings=warnings)


def _content(before: Estimate, after: Estimate, refined: RefinedViews) -> dict[str, Any]:
    """The part ``refined`` of ``estimate.json``."""
    change = {}
    for name, alpha, ratio in zip(
        after.names, after.fabric.alpha, after.fabric.beta / after.fabric.alpha, strict=True
    ):
        k = before.names.index(name)
        change[name] = {
            "alpha_before_uN_m": float(before.fabric.alpha[k]) / MICRO,
            "alpha_percent": 100 * float(alpha / before.fabric.alpha[k] - 1),
            "beta_over_alpha_mm": 1e3 * float(ratio - before.fabric.beta[k]
                                              / before.fabric.alpha[k]),
        }
    content = {
        "by": "depth", "change": change, "misfit_before": refined.start_value,
        "misfit": refined.best.value, "simulations": refined.simulations,
        "status": refined.status.value, "message": refined.message,
    }
    if refined.uncertainty is not None:
        content["reduced_chi2"] = refined.uncertainty.reduced_chi2
    return {"refined": content}


def _resimulation(views: np.ndarray, refined: RefinedViews) -> Resimulation:
    """The refined drape, seen as it was compared."""
    objective = refined.objective
    try:
        nuisance = fit_nuisances(objective, refined.drape.positions, refined.best.nuisance)
    except KeyboardInterrupt:
        nuisance = refined.best.nuisance  # as good as can be: the estimate must not be lost
    simulated = objective.render(refined.drape.positions, nuisance).astype(np.float32)
    profiles = tuple(radius_profile(v, objective.camera, height=PROFILE_HEIGHT)
                     for v in (views, simulated))
    return Resimulation(
        views=simulated, profiles=profiles, folds=tuple(count_folds(p) for p in profiles),
        overlap=silhouette_overlap(views, simulated), statuses=(refined.drape.status.value,),
        drape=refined.drape, camera=objective.camera, turn=float(nuisance[0]))
