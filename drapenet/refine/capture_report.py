"""``python infer.py capture=DIR refine=depth``: the network's estimate, corrected by simulation."""

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from tqdm import tqdm

from data.cameras import Camera
from data.captures import Capture
from data.fabrics import fabric_from_theta, to_theta
from data.prior.gaussian import GaussianPrior
from drapenet.canonical import square_turn
from drapenet.convention import SWAPPED, stiff_first
from drapenet.estimate import LEAST_CONFIDENCE, Estimate
from drapenet.refine.depth import DepthViews
from drapenet.refine.objective import fit_nuisances
from drapenet.refine.views import FREE_ROUNDS, HELD_ROUNDS, SPREAD, RefinedViews, refine_views
from drapenet.registration import count_folds, radius_profile, silhouette_overlap
from drapenet.resimulate import PROFILE_HEIGHT, Resimulation
from drapenet.table import error_table
from sim.material import MICRO, REFERENCE_DENSITY
from sim.scene import Rig


@dataclass(frozen=True)
class RefinedEstimate:
    """What the refinement of one capture came to.

    Attributes:
        estimate: the corrected one; its stiff axis is the specimen's as it was found.
        content: parts of ``estimate.json`` that differ from the network's.
        resimulation: the refined drape beside the capture.
    """

    estimate: Estimate
    content: dict[str, Any]
    resimulation: Resimulation


def refine_capture(
    estimate: Estimate,
    capture: Capture,
    views: np.ndarray,
    camera: Camera,
    *,
    rig: Rig,
    known: GaussianPrior,
    edge: float,
) -> RefinedEstimate | None:
    """Refine the network's estimate until its drape looks like the views, with a progress bar.

    Interrupted from the keyboard, the best so far is handed back. None if no drape converges.

    Args:
        estimate: in the order stiff, bias, soft; stiff lies along the x axis of the specimen.
        views: (4, H, W) z-depth, m, as ``camera`` saw them.
        known: what the network's word says of theta, see :func:`drapenet.estimate.belief`.
        edge: m, at the rim of the specimen's mesh in the last round.
    """
    fabric = estimate.fabric.at_density(REFERENCE_DENSITY)
    theta = to_theta(fabric.alpha, fabric.beta)
    turns = specimen_turns(estimate, capture, DepthViews(views, camera, np.zeros((0, 3), int)), rig)
    # Each round comes with a shape and up to two simulations of its own.
    total = (sum(FREE_ROUNDS) + sum(3 + evaluations for evaluations, _ in HELD_ROUNDS)
             + (len(SPREAD) + 1) * len(turns) + 3)
    with tqdm(total=total, desc="refining", unit="sim", leave=False) as bar:
        def progress(simulations: int, value: float) -> None:
            bar.update(simulations - bar.n)
            bar.set_postfix(misfit=f"{value:.0f}")

        refined = refine_views(views, camera, theta, turns=turns, rig=rig, edge=edge,
                               prior=known, progress=progress)
    if refined is None:
        return None
    corrected = _corrected(estimate, refined, capture.density)
    return RefinedEstimate(corrected, _content(estimate, corrected, refined, known),
                           _resimulation(views, refined))


def specimen_turns(
    estimate: Estimate, capture: Capture, objective: DepthViews, rig: Rig
) -> list[float]:
    """Directions, rad, in which the stiff yarns may lie in the first view: one, or two.

    The marked warp gives the sides of the specimen, otherwise its corners do; the network says
    which of the two sides is the stiff one, if it can.
    """
    if capture.warp_direction is not None:
        side = capture.warp_direction
    else:
        side = square_turn(objective.points(objective.start)[0], rig)
    sides = [side % math.pi, (side + math.pi / 2) % math.pi]
    prediction = estimate.prediction
    if prediction.axis_confidence < LEAST_CONFIDENCE:
        return sides

    def away(turn: float) -> float:
        gap = (turn - prediction.axis) % math.pi
        return min(gap, math.pi - gap)

    return [min(sides, key=away)]


def _corrected(estimate: Estimate, refined: RefinedViews, density: float) -> Estimate:
    """The estimate with the moduli found, the stiffer yarns first again."""
    theta, turn = refined.best.theta, float(refined.best.nuisance[0])
    names, spread = estimate.names, estimate.prediction.spread
    if theta[0] < theta[2]:
        theta, spread, turn = theta[SWAPPED], spread[SWAPPED], turn + math.pi / 2
        if "warp" in names:
            names = names[::-1]
    return replace(
        estimate, names=names, fabric=fabric_from_theta(theta).at_density(density),
        prediction=replace(estimate.prediction, targets=theta, spread=spread,
                           axis=turn % math.pi))


def _content(
    before: Estimate, after: Estimate, refined: RefinedViews, known: GaussianPrior
) -> dict[str, Any]:
    """The part ``refined`` of ``estimate.json``, and the errors that now are typical."""
    warnings = list(after.warnings)
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
    content: dict[str, Any] = {"refined": {
        "by": "depth", "change": change, "misfit_before": refined.start_value,
        "misfit": refined.best.value, "simulations": refined.simulations,
        "status": refined.status.value, "message": refined.message,
    }}
    errors = known.deviation
    if refined.uncertainty is None:
        warnings.append("the refinement gives no uncertainty; the network's typical error stands")
    else:
        errors = refined.uncertainty.theta
        content["refined"]["reduced_chi2"] = refined.uncertainty.reduced_chi2
    content["typical_error"] = error_table(after.names, errors[stiff_first(refined.best.theta)])
    content["warnings"] = warnings
    return content


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
