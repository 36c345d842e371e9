"""Fabrics of the prior: drawn, draped, captured, and estimated by the bundled network."""

from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from common.command import compose_config
from common.errors import InputError
from data.captures.capture import DepthCapture
from data.dataset.config import Options, config_from_options
from data.dataset.folder import finished_manifest
from data.dataset.plan import DrapePlan, Stream, plan_drape, stream
from data.dataset.shards import Shard
from data.fabrics.fabrics import fabric_from_theta
from data.fabrics.nuisances import Nuisances
from data.fabrics.prior import load_prior, sample_admissible
from sim.cloth import Laws
from sim.draping import Drape, drape
from sim.material import REFERENCE_DENSITY, Fabric
from sim.rig import SQUARE_RIG, Rig

if TYPE_CHECKING:  # imported on use, because speed and memory are measured without them
    from data.render.setups import Setups, SyntheticCapture
    from drapenet.network.checkpoint import Header

RIG = SQUARE_RIG
CLEAN = {"views": (0.0, 0.0, 0.0, 1.0), "sensors": {"smooth": 1.0}, "turn": 0.0, "focal": 0.0,
         "border": 0, "holes": 0, "hem_share": 0.0}
"""Fields of a set-up: exact quarter turns, a smooth sensor, an exact cut-out."""
IDEAL = CLEAN | {"roll": 0.0, "pitch": (np.radians(38.0),) * 2, "distance": (0.527, 0.527),
                 "fill": (1.0, 1.0), "above": (0.036, 0.036), "aside": (0.0, 0.0)}
"""The same with the nominal pose of the camera."""


def prior_fabric(index: int, seed: int) -> Fabric:
    """Fabric ``index`` of the Gaussian prior."""
    drawn, _ = sample_admissible(load_prior("gaussian"), stream(seed, Stream.FABRIC, index))
    return fabric_from_theta(drawn)


def plan_specimen(
    number: int, *words: str, seed: int, nuisances: str = "none", rig: Rig = RIG
) -> DrapePlan:
    """A specimen as in a dataset of the plain prior; ``words``: overrides of its config."""
    config = config_from_options(compose_config("generate", [
        f"nuisances={nuisances}", f"dataset.testers=[{rig.name}]", f"seed={seed}",
        *words], schema=Options))
    return plan_drape(number, config=config.sampling, prior=config.prior)


def drape_specimen(
    plan: DrapePlan, *, edge: float, start: str = "", seed: int | None = None,
    offset: tuple[float, float] = (0.0, 0.0), nuisances: Nuisances | None = None,
    laws: Laws | None = None,
) -> Drape:
    """Simulate a specimen, centred on its plate if no offset is given.

    Raises:
        InputError: the simulation does not converge.
    """
    nuisances = nuisances or plan.nuisances
    shape = drape(fabric_from_theta(plan.theta), rig=nuisances.rig(plan.rig), edge=edge,
                  start=start or plan.fallback, seed=plan.seed if seed is None else seed,
                  offset=offset, laws=laws or nuisances.laws)
    if not shape.converged:
        raise InputError(f"a drape of fabric {plan.fabric} did not converge ({shape.message}); "
                         "choose another seed=")
    return shape


def drape_as_planned(plan: DrapePlan, *, edge: float) -> Drape:
    """Simulate a specimen with the offset and the start of its plan."""
    return drape_specimen(plan, edge=edge, start=plan.start, offset=tuple(plan.offset))


def converged_drapes(root: Path) -> Iterator[tuple[Shard, int]]:
    """Converged drapes of a dataset by shard and row; the last shards first, as networks are
    trained on the first."""
    for name in reversed(list(finished_manifest(root)["shards"])):
        shard = Shard(root / name)
        for row in np.flatnonzero(shard.column("status") == "converged"):
            yield shard, row


def ideal_setups(**changes: object) -> "Setups":
    """Set-up without faults, with ``changes``."""
    from data.render.setups import Setups

    return replace(Setups.load("real"), **IDEAL | changes)


def capture_drape(
    shape: Drape, setups: "Setups", rng: np.random.Generator, rig: Rig = RIG
) -> "SyntheticCapture":
    """Capture a drape with a random set-up."""
    return setups.capture(shape.positions, shape.faces, rng, rig=rig)


def as_read(synthetic: "SyntheticCapture", rig: Rig = RIG) -> DepthCapture:
    """A synthetic capture as if it were read from a folder, with the direction of the warp."""
    return DepthCapture(synthetic.views, synthetic.intrinsics, synthetic.turns,
                        density=REFERENCE_DENSITY, rig=rig, path=Path(),
                        warp_direction=synthetic.orientation % np.pi)


@cache
def header() -> "Header":
    """Header of the bundled network."""
    from drapenet.network.checkpoint import read_header

    return read_header()
