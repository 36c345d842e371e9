"""Posterior samples from maps of captures by the network.

Rotated by a symmetry of its specimen, or reflected, a drape is an equally likely drape of the same
fabric. The posterior is the mixture of the network's posteriors for eight such maps.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from common.types import Theta
from data.fabrics.fabrics import from_theta
from drapenet.network.checkpoint import Header
from drapenet.network.model import Batch, MapNet, compressed
from drapenet.network.posterior import Samples
from drapenet.network.targets import MODULI, Symmetry
from drapenet.views.radial_map import RadialMap
from sim.material import is_admissible

DRAWS = 500  # of each of the eight posteriors


@dataclass(frozen=True)
class Draws:
    """Samples of one capture's posterior, first yarns before bias and second yarns."""

    theta: Theta
    axis: np.ndarray  # (S,) rad, direction of the first yarns in the first view
    impossible: float  # share of all samples that was not admissible and is removed

    @classmethod
    def possible(cls, theta: Theta, axis: np.ndarray) -> "Draws":
        """The admissible samples, ``axis`` (S,); all if none is."""
        possible = is_admissible(*from_theta(theta))
        kept = possible if possible.any() else ~possible
        return cls(theta[kept], axis[kept], float(1 - possible.mean()))


@torch.no_grad()
def sample_targets(network: MapNet, header: Header, batch: Batch) -> Samples:
    """8 :data:`DRAWS` samples of the targets, not standardised."""
    symmetry, many = Symmetry.all(), len(batch.known)
    disc = len(header.scale.mean) > MODULI
    drawn = []
    for k in range(len(symmetry.cells)):
        shown = Symmetry(symmetry.cells[k].expand(many), symmetry.mirror[k].expand(many))
        mixture = batch.turned(shown).through(network).cpu()
        samples = mixture.sample(DRAWS, torch.Generator().manual_seed(k)).double()
        targets = torch.from_numpy(header.scale.decode(samples.numpy()))
        drawn += [shown.undone(part, disc=disc) for part in targets]
    return torch.stack(drawn).numpy()


def predict(
    network: MapNet, header: Header, maps: Sequence[RadialMap], *, membrane: float | None = None
) -> list[Draws]:
    """Posterior samples of each capture; ``membrane``: N/m along the yarns at 300 g/m²."""
    views = np.array([drape.views for drape in maps])
    batch = Batch.of(*compressed(maps), views, np.full(len(maps), membrane, np.float32))  # or NaN
    samples = sample_targets(network, header, batch)
    draws = []
    for targets, drape in zip(samples.swapaxes(0, 1), maps, strict=True):
        axis = np.full(len(targets), drape.zero)
        if targets.shape[1] > MODULI:
            axis += np.arctan2(targets[:, 7], targets[:, 6]) / 2
        draws.append(Draws.possible(targets[:, :MODULI], axis))
    return draws
