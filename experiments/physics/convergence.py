"""Share of drapes that converge, their self-intersections and penetration of the cylinder.

Fabrics from the bundled prior, including its soft tail, each from a sine and from a fold start.
Fabrics, starts, seeds and offsets are planned as for a dataset (:mod:`data.dataset.plan`).
"""

from collections import Counter

import numpy as np

from common.configs import metres
from data.dataset.config import SamplingConfig
from data.dataset.plan import plan_drape
from data.fabrics.fabrics import fabric_from_theta
from data.fabrics.prior import load_prior
from experiments.report import Report
from experiments.study import CaseKeys, Sample, Study, samples_of
from sim.draping import drape
from sim.measures import drape_coefficient, fold_count, max_penetration, maximum_stretch

MAX_RESIDUAL = 1e-3  # relative to the weight of a vertex
MAX_STEP = 0.02  # mm
MAX_PENETRATION = 0.2  # mm, penetration of the cylinder
MIN_SHARE = 0.99  # of the drapes

STARTS = ("sine", "fold")


class Keys(CaseKeys):
    fabrics: int = 64  # drawn from the prior
    seed: int = 0  # of fabrics and starts
    edge_mm: float | None = None  # mesh edges at the plate's rim; null: those of the simulator


def one_drape(number: int, seed: int, edge_mm: float | None) -> Sample:
    """Simulate drape ``number`` of the plan."""
    config = SamplingConfig(seed=seed, starts=STARTS, starts_per_fabric=len(STARTS))
    plan = plan_drape(number, config=config, prior=load_prior("gaussian"))
    fabric = fabric_from_theta(plan.theta)
    result = drape(fabric, edge=metres(edge_mm), start=plan.start, seed=plan.seed,
                   offset=tuple(plan.offset))
    return {
        "fabric": plan.fabric,
        "start": plan.start,
        "alpha_uN_m": (1e6 * fabric.alpha).tolist(),
        "beta_over_alpha_mm": (1e3 * plan.theta[3:]).tolist(),
        "status": result.status.value,
        "message": result.message,
        "residual": _finite(result.outcome.residual),
        "step_mm": _finite(result.outcome.step),
        "positive_definite": bool(result.outcome.positive_definite),
        "self_intersections": result.self_intersections,
        "entry_mm": _finite(1e3 * max_penetration(result.positions, result.faces, result.rig)),
        "drape_coefficient": drape_coefficient(result.positions, result.faces, result.rig),
        "folds": fold_count(result.positions, result.rest, result.rig),
        "largest_stretch": maximum_stretch(result.positions, result.rest, result.faces,
                                           result.held),
        "iterations": result.iterations,
        "seconds": round(result.seconds, 2),
    }


def _finite(value: float) -> float | None:
    """``value`` for JSON; None if it is not finite."""
    return float(value) if np.isfinite(value) else None


def reaches_criterion(run: Sample) -> bool:
    """Whether a drape meets the convergence criterion, independent of its status."""
    return bool(run["positive_definite"]
                and run["residual"] is not None and run["residual"] < MAX_RESIDUAL
                and run["step_mm"] is not None and run["step_mm"] < MAX_STEP)


def summarise(runs: list[Sample]) -> Report:
    """Shares and worst cases over the drapes ``runs``."""
    reached = [run for run in runs if reaches_criterion(run)]
    accepted = [run for run in runs if run["status"] == "converged"]
    return {
        "drapes": len(runs),
        "reached_criterion": len(reached),
        "share_reached": len(reached) / len(runs),
        "accepted": len(accepted),
        "statuses": dict(Counter(run["status"] for run in runs)),
        "others": [
            {key: run[key] for key in ("fabric", "start", "alpha_uN_m", "status", "message")}
            for run in runs if not reaches_criterion(run)
        ],
        "accepted_that_intersect_themselves": sum(r["self_intersections"] > 0 for r in accepted),
        "deepest_entry_of_accepted_mm": max((r["entry_mm"] for r in accepted), default=0.0),
        "largest_stretch_of_accepted": max((r["largest_stretch"] for r in accepted), default=0.0),
        "mean_seconds": float(np.mean([run["seconds"] for run in runs])),
    }


def run(keys: Keys) -> Report:
    """Simulate all drapes."""
    runs = list(samples_of(one_drape, keys, len(STARTS) * keys.fabrics, kind="drape").values())
    summary = summarise(runs)
    passed = (
        summary["share_reached"] >= MIN_SHARE
        and summary["accepted_that_intersect_themselves"] == 0
        and summary["deepest_entry_of_accepted_mm"] <= MAX_PENETRATION
    )
    return {"criterion": {"residual": MAX_RESIDUAL, "step_mm": MAX_STEP,
                          "entry_mm": MAX_PENETRATION, "share": MIN_SHARE},
            "passed": passed, "all": summary, "drapes": runs}


STUDY = Study(Keys, run)
