"""Energies of many cloths at once: PyTorch twins of the energies of the default drape."""

from collections.abc import Sequence

import torch

from common.errors import InputError
from sim.batched.energies.base import BatchedEnergy
from sim.batched.energies.contact import BatchedContact
from sim.batched.energies.fold_limit import BatchedFoldLimit
from sim.batched.energies.gravity import BatchedGravity
from sim.batched.energies.membrane import BatchedMembrane
from sim.batched.energies.midedge import BatchedMidEdge
from sim.energies.base import Energy
from sim.energies.contact import ObstacleContact
from sim.energies.fold_limit import FoldLimit
from sim.energies.gravity import Gravity
from sim.energies.membrane import CorotationalMembrane
from sim.energies.midedge import MidEdgeBending

__all__ = ["BatchedEnergy", "batch_energies"]

_TWINS = {
    CorotationalMembrane: BatchedMembrane,
    MidEdgeBending: BatchedMidEdge,
    FoldLimit: BatchedFoldLimit,
    Gravity: BatchedGravity,
    ObstacleContact: BatchedContact,
}


def batch_energies(
    samples: Sequence[Sequence[Energy]], device: torch.device | str = "cpu"
) -> list[BatchedEnergy]:
    """The energies of several samples, term by term.

    Args:
        samples: the terms of each, in one order of types; as in
            :attr:`sim.potential.Potential.energies`.
        device: where they are evaluated.

    Raises:
        InputError: samples that differ in their terms, or a term without a batched twin.
    """
    kinds = [[type(term) for term in sample] for sample in samples]
    if not kinds or any(own != kinds[0] for own in kinds):
        raise InputError("a batch needs samples with the same kinds of energy")
    for kind in kinds[0]:
        if kind not in _TWINS:
            raise InputError(f"{kind.__name__} cannot be evaluated in a batch; make such drapes "
                             "one by one (together=False)")
    return [
        _TWINS[kind].stack(terms, device)
        for kind, terms in zip(kinds[0], zip(*samples, strict=True), strict=True)
    ]
