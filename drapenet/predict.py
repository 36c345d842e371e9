"""From maps of captures to samples of the posterior, by the network.

A drape turned by the symmetries of its specimen, or reflected, is as likely a drape of the same
fabric. So the network is asked about eight such maps, and the posterior is the mixture of its eight
answers: wider where they disagree.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from data.fabrics import from_theta
from drapenet.canonical import DrapeMap
from drapenet.checkpoint import Header
from drapenet.maps import WEIGHT_UNIT, compressed
from drapenet.network import MapNet, known_of
from drapenet.targets import MODULI, Symmetry
from sim.material import is_admissible

DRAWS = 500
"""Samples of each of the eight answers."""


@dataclass(frozen=True)
class Draws:
    """Samples of one capture's posterior.

    Attributes:
        theta: (S, 6) at 300 g/m²: of one of the two yarns, the bias, the other yarn.
        axis: (S,) direction of the first of them in the first view, rad.
        impossible: share of what the network said that no cloth can have, and that was left out.
    """

    theta: np.ndarray
    axis: np.ndarray
    impossible: float


@torch.no_grad()
def sample_targets(
    network: MapNet, header: Header, distance: torch.Tensor, weight: torch.Tensor,
    known: torch.Tensor,
) -> np.ndarray:
    """(8 DRAWS, N, T) samples of the targets (:mod:`drapenet.targets`), in their units.

    Args:
        network: of ``header``, in evaluation mode.
        distance, weight, known: (N, ...), scaled, as for :class:`drapenet.network.MapNet`.
    """
    symmetry, many = Symmetry.all(), len(distance)
    disc = len(header.scale.mean) > MODULI
    drawn = []
    for k in range(len(symmetry.cells)):
        shown = Symmetry(symmetry.cells[k].expand(many), symmetry.mirror[k].expand(many))
        mixture = network(shown.of_maps(distance), shown.of_maps(weight), known).cpu()
        samples = mixture.sample(DRAWS, torch.Generator().manual_seed(k)).double()
        targets = torch.from_numpy(header.scale.decode(samples.numpy()))
        drawn += [shown.undone(part, disc=disc) for part in targets]
    return torch.stack(drawn).numpy()


def predict(
    network: MapNet, header: Header, maps: Sequence[DrapeMap], *,
    membrane: float | None = None, friction: float | None = None,
) -> list[Draws]:
    """The posterior of each capture.

    Args:
        network: of ``header``, in evaluation mode.
        membrane: N/m along the yarns, friction: N·m per metre; where they are known.
    """
    distance, weight = map(torch.from_numpy, compressed(maps))
    views = torch.tensor([len(one.turns) for one in maps])
    given = [torch.full((len(maps),), np.nan if value is None else value)
             for value in (membrane, friction)]
    samples = sample_targets(network, header, distance.float(), weight * WEIGHT_UNIT,
                             known_of(views, *given))
    return [_draws(samples[:, k], one.zero) for k, one in enumerate(maps)]


def _draws(targets: np.ndarray, zero: float) -> Draws:
    """Of targets (S, T), for a map that begins at ``zero``, rad."""
    axis = np.full(len(targets), zero)
    if targets.shape[1] > MODULI:
        axis += np.arctan2(targets[:, 7], targets[:, 6]) / 2
    possible = is_admissible(*from_theta(targets[:, :MODULI]))
    kept = possible if possible.any() else ~possible
    return Draws(targets[kept, :MODULI], axis[kept], float(1 - possible.mean()))
