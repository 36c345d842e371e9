"""Fabrics with known moduli: drawn from the prior, draped, captured and estimated."""

from common.command import compose_config
from common.errors import InputError
from data.dataset.options import Options, config_from_options
from data.dataset.plan import DrapePlan, plan_drape
from data.fabrics.fabrics import fabric_from_theta
from data.fabrics.nuisances import Nuisances
from sim.cloth import Laws
from sim.drape import DrapeResult, drape
from sim.rig import Rig

CLEAN = {"views": (0.0, 0.0, 0.0, 1.0), "sensors": {"smooth": 1.0}, "turn": 0.0, "focal": 0.0,
         "border": 0, "holes": 0, "hem_share": 0.0}
"""Fields of :class:`data.render.setups.Setups`: exact quarter turns, a smooth sensor, an exact cut-
out."""


def plan_specimen(number: int, *, rig: Rig, nuisances: str, seed: int) -> DrapePlan:
    """Draw a fabric from the prior, without the extra soft fabrics of training, and a specimen."""
    words = [f"nuisances={nuisances}", f"dataset.testers=[{rig.name}]", f"seed={seed}",
             "dataset.soft_share=0"]
    config = config_from_options(compose_config("generate", words, schema=Options))
    return plan_drape(number, config=config.sampling, prior=config.prior)


def drape_plan(
    plan: DrapePlan, *, rig: Rig, edge: float, start: str = "", seed: int | None = None,
    offset: tuple[float, float] | None = None, nuisances: Nuisances | None = None,
    laws: Laws | None = None,
) -> DrapeResult:
    """Simulate the drape of a plan; start, seed, offset, nuisances and laws may be overridden.

    Args:
        edge: m, mesh edges at the rim.

    Raises:
        InputError: the drape does not converge.
    """
    used = nuisances or plan.nuisances
    result = drape(fabric_from_theta(plan.theta), rig=used.rig(rig), edge=edge,
                   start=start or plan.start, seed=plan.seed if seed is None else seed,
                   offset=tuple(plan.offset) if offset is None else offset,
                   laws=laws or used.laws)
    if not result.converged:
        raise InputError(f"a drape of fabric {plan.fabric} did not converge ({result.message}); "
                         "choose another seed=")
    return result


def known_drape(
    number: int, *, rig: Rig, nuisances: str, edge_mm: float, seed: int
) -> tuple[DrapePlan, DrapeResult]:
    """Draw a fabric and a specimen from the prior, and simulate the drape."""
    plan = plan_specimen(number, rig=rig, nuisances=nuisances, seed=seed)
    return plan, drape_plan(plan, rig=rig, edge=1e-3 * edge_mm)
