"""Targets of the network: the moduli along the specimen's yarns.

The map of a square begins at a side: its six targets are theta with the yarns along azimuth 0 in
place of the warp. That of a disc begins anywhere: its targets are theta with the stiffer yarns
first, and their direction w (cos 2 psi, sin 2 psi), w = tanh(log(alpha_stiff/alpha_soft)), which
vanishes for equal yarns, where it would jump by a right angle.
"""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
import torch

from common.types import Theta
from drapenet.views.directions import AZIMUTHS
from sim.material import FIRST, SECOND, SWAPPED

MODULI = 6  # the first targets; a disc has two more
Targets = Annotated[np.ndarray, "(..., T), T = 6 for squares and 8 for discs"]


def targets_of(theta: Theta, warp: np.ndarray, *, disc: bool) -> Targets:
    """Targets, not standardised; ``warp``: (N,) rad, azimuths of the warp in the maps."""
    if not disc:
        odd = np.rint(warp / (np.pi / 2)).astype(int) % 2 == 1
        return np.where(odd[:, None], theta[:, SWAPPED], theta)
    soft = theta[:, FIRST] < theta[:, SECOND]
    sorted_theta = np.where(soft[:, None], theta[:, SWAPPED], theta)
    psi = warp + soft * (np.pi / 2)
    weight = np.tanh(np.abs(theta[:, FIRST] - theta[:, SECOND]))
    return np.column_stack([sorted_theta, weight * np.cos(2 * psi), weight * np.sin(2 * psi)])


@dataclass(frozen=True)
class Symmetry:
    """Rotations and reflections of N maps that give equally likely captures."""

    cells: torch.Tensor  # (N,) azimuth cells of the rotation, quarter turns for squares
    mirror: torch.Tensor  # (N,) whether a map is first reflected at azimuth 0

    @classmethod
    def draw(cls, count: int, *, disc: bool, rng: np.random.Generator) -> "Symmetry":
        cells = rng.integers(AZIMUTHS, size=count) if disc else (
            rng.integers(4, size=count) * (AZIMUTHS // 4))
        return cls(torch.from_numpy(cells), torch.from_numpy(rng.integers(2, size=count) == 1))

    @classmethod
    def all(cls) -> "Symmetry":
        """The eight symmetries of a square, over which estimates are averaged."""
        cells = torch.arange(4).repeat(2) * (AZIMUTHS // 4)
        return cls(cells, torch.arange(8) >= 4)

    def of_maps(self, maps: torch.Tensor) -> torch.Tensor:
        """Apply to maps (N, AZIMUTHS, ELEVATIONS)."""
        azimuth = (torch.arange(AZIMUTHS) - self.cells[:, None]) % AZIMUTHS
        azimuth = torch.where(self.mirror[:, None], AZIMUTHS - 1 - azimuth, azimuth)
        return maps[torch.arange(len(maps))[:, None], azimuth.to(maps.device)]

    def of_targets(self, targets: torch.Tensor, *, disc: bool) -> torch.Tensor:
        """Apply to targets (N, T)."""
        if not disc:
            odd = (self.cells // (AZIMUTHS // 4)) % 2 == 1
            return torch.where(odd[:, None], targets[:, SWAPPED], targets)
        axis = torch.complex(targets[:, 6], torch.where(self.mirror, -1.0, 1.0) * targets[:, 7])
        axis = axis * torch.exp(2j * self.cells * (2 * torch.pi / AZIMUTHS))
        return torch.column_stack([targets[:, :MODULI], axis.real, axis.imag]).to(targets)

    def undone(self, targets: torch.Tensor, *, disc: bool) -> torch.Tensor:
        """The inverse of :meth:`of_targets`."""
        back = torch.where(self.mirror, self.cells, -self.cells)  # a reflection is its own inverse
        return Symmetry(back, self.mirror).of_targets(targets, disc=disc)


@dataclass(frozen=True)
class TargetScale:
    """Standardisation of the targets, by a mean and a deviation of each."""

    mean: Targets
    std: Targets

    @staticmethod
    def fit(targets: Targets, *, disc: bool) -> "TargetScale":
        """Scale of a training set's targets, invariant under the symmetries."""
        mean, std = targets.mean(axis=0), np.maximum(targets.std(axis=0), 1e-12)
        if disc:
            mean[MODULI:], std[MODULI:] = 0.0, std[MODULI:].mean()
        else:
            mean, std = (mean + mean[SWAPPED]) / 2, (std + std[SWAPPED]) / 2
        return TargetScale(mean, std)

    def encode(self, targets: Targets) -> Targets:
        return (targets - self.mean) / self.std

    def decode(self, standardised: Targets) -> Targets:
        return standardised * self.std + self.mean
