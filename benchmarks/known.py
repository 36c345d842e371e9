"""Known fabrics: planned from the prior, draped, captured without faults, and estimated."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from common.command import compose_config
from common.errors import InputError
from data.cameras import Intrinsics
from data.captures import Capture, whole_turns
from data.fabrics import fabric_from_theta
from data.nuisances import Nuisances
from data.options import Options, config_from_options
from data.sampling import DrapePlan, plan_drape
from drapenet.checkpoint import Header
from sim.drape import DrapeResult, drape
from sim.laws import Laws
from sim.material import REFERENCE_DENSITY
from sim.scene import Rig

if TYPE_CHECKING:
    from drapenet.estimate import Estimate

CLEAN = {"views": (0.0, 0.0, 0.0, 1.0), "sensors": {"smooth": 1.0}, "turn": 0.0, "focal": 0.0,
         "border": 0, "holes": 0, "hem_share": 0.0}
"""Of :class:`data.setups.Setups`: four exact quarter turns, a smooth sensor, a clean cut-out."""


def planned(number: int, *, rig: str, nuisances: str, seed: int) -> DrapePlan:
    """A fabric of the prior, without the training's share of very soft ones, and a specimen of it.
    """
    words = [f"nuisances={nuisances}", f"rig={rig}", f"seed={seed}", "dataset.soft_share=0"]
    config = config_from_options(compose_config("generate", words, schema=Options))
    return plan_drape(number, config=config.sampling, prior=config.prior)


def draped(
    plan: DrapePlan, *, rig: str, edge: float, start: str = "", seed: int | None = None,
    offset: tuple[float, float] | None = None, nuisances: Nuisances | None = None,
    laws: Laws | None = None,
) -> DrapeResult:
    """The drape of a planned specimen, with another start, seed, offset, nuisances or laws where
    given.

    Args:
        edge: m, at the rim of the mesh.

    Raises:
        InputError: it does not converge.
    """
    own = nuisances or plan.nuisances
    result = drape(fabric_from_theta(plan.theta), rig=own.rig(Rig.from_name(rig)), edge=edge,
                   start=start or plan.start, seed=plan.seed if seed is None else seed,
                   offset=tuple(plan.offset) if offset is None else offset,
                   laws=laws or own.laws)
    if not result.converged:
        raise InputError(f"a drape of fabric {plan.fabric} did not converge ({result.message}); "
                         "choose another seed=")
    return result


def known_drape(
    number: int, *, rig: str, nuisances: str, edge_mm: float, seed: int
) -> tuple[DrapePlan, DrapeResult]:
    """A fabric of the prior and specimen of it, and its drape."""
    plan = planned(number, rig=rig, nuisances=nuisances, seed=seed)
    return plan, draped(plan, rig=rig, edge=1e-3 * edge_mm)


def estimated(
    views: np.ndarray, intrinsics: Intrinsics, header: Header, *, friction: float | None = None
) -> "Estimate":
    """What the network of ``header`` says of a capture, as ``infer.py`` does, of 300 g/m².

    Args:
        views: (K, H, W) z-depth, m, background 0; the table turned by whole K-ths of a turn.
        intrinsics: of these pictures.
        friction: N·m per metre, where the network is given it.
    """
    from drapenet.inference import infer_capture

    capture = Capture(views, intrinsics, whole_turns(len(views)), REFERENCE_DENSITY, None,
                      header.rig, Path(), ())
    return infer_capture(capture, header, friction=friction).estimate
