"""Fabrics of the prior and of datasets, drawn and draped; the header of the bundled network."""

from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from common.command import compose_config
from common.errors import InputError
from data.dataset.config import Options, config_from_options
from data.dataset.folder import finished_manifest
from data.dataset.plan import DrapePlan, Stream, plan_drape, stream
from data.dataset.shards import Shard
from data.fabrics.fabrics import fabric_from_theta
from data.fabrics.prior import load_prior, sample_admissible
from sim.draping import Drape, drape
from sim.material import Fabric
from sim.rig import Rig

if TYPE_CHECKING:  # imported on use, because speed and memory are measured without them
    from drapenet.network.checkpoint import Header


def prior_fabric(index: int, seed: int) -> Fabric:
    """Fabric ``index`` of the Gaussian prior."""
    drawn, _ = sample_admissible(load_prior("gaussian"), stream(seed, Stream.FABRIC, index))
    return fabric_from_theta(drawn)


def plan_specimen(number: int, *words: str, seed: int, nuisances: str, rig: Rig) -> DrapePlan:
    """A specimen as in a dataset of the plain prior; ``words``: overrides of its config."""
    config = config_from_options(compose_config("generate", [
        f"nuisances={nuisances}", f"dataset.testers=[{rig.name}]", f"seed={seed}",
        *words], schema=Options))
    return plan_drape(number, config=config.sampling, prior=config.prior)


def drape_as_planned(plan: DrapePlan, *, edge: float) -> Drape:
    """Simulate a specimen with the offset and the start of its plan.

    Raises:
        InputError: the simulation does not converge.
    """
    shape = drape(fabric_from_theta(plan.theta), rig=plan.nuisances.rig(plan.rig), edge=edge,
                  start=plan.start, seed=plan.seed, offset=tuple(plan.offset),
                  laws=plan.nuisances.laws)
    if not shape.converged:
        raise InputError(f"a drape of fabric {plan.fabric} did not converge ({shape.message}); "
                         "choose another seed=")
    return shape


def converged_drapes(root: Path) -> Iterator[tuple[Shard, int]]:
    """Converged drapes of a dataset by shard and row; the last shards first, as networks are
    trained on the first."""
    for name in reversed(list(finished_manifest(root)["shards"])):
        shard = Shard(root / name)
        for row in np.flatnonzero(shard.column("status") == "converged"):
            yield shard, row


@cache
def header() -> "Header":
    """Header of the bundled network."""
    from drapenet.network.checkpoint import read_header

    return read_header()
