"""The network and its input: a ResNet-18 on radial maps, with circular padding in azimuth."""

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Annotated

import numpy as np
import torch
from torch.nn.functional import pad

from drapenet.network.posterior import Mixture, outputs_of
from drapenet.network.targets import Symmetry
from drapenet.views.directions import AZIMUTHS, ELEVATIONS
from drapenet.views.radial_map import RadialMap

CHANNELS = 4  # distance, weight, cosine and sine of twice the azimuth
KNOWN = 5  # scalar inputs, see :func:`known_of`
WEIGHT_UNIT = 1 / 32  # of the stored logarithm of 1 + weight
_HARMONICS = (2, 4)  # of the azimuth, for pooling features beside their mean
_MEMBRANE = 316.0  # N/m, unit of the input
_NO_FRICTION = (1.0, -1.0)
"""Two inputs of the bundled networks, trained with friction beside the moduli: there is none, as
the moduli are those of the loading curve."""

MapTensor = Annotated[torch.Tensor, "(N, AZIMUTHS, ELEVATIONS) float32"]


def compressed(maps: list[RadialMap]) -> tuple[np.ndarray, np.ndarray]:
    """(N, AZIMUTHS, ELEVATIONS) distances, m, and logarithms of 1 + weight in their unit."""
    shape = (len(maps), AZIMUTHS, ELEVATIONS)
    distance = np.array([part.distance for part in maps], np.float16).reshape(shape)
    weight = np.array([np.log1p(part.weight) for part in maps]).reshape(shape)
    return distance, np.minimum(np.rint(weight / WEIGHT_UNIT), 255).astype(np.uint8)


def known_of(views: torch.Tensor, membrane: torch.Tensor) -> torch.Tensor:
    """(N, KNOWN) scalar inputs: numbers of views, and N/m along the yarns, NaN if unknown."""
    finite, value = torch.isfinite(membrane), torch.log(membrane / _MEMBRANE)
    constants = [torch.full(views.shape, number) for number in _NO_FRICTION]
    return torch.stack([views.float() / 4 - 1, finite.float(),
                        torch.where(finite, value, 0.0).float(), *constants], dim=1)


@dataclass(frozen=True)
class Batch:
    """Inputs of the network for N captures."""

    distance: MapTensor  # m
    weight: MapTensor  # logarithm of 1 + weight
    known: torch.Tensor  # (N, KNOWN), :func:`known_of`
    targets: torch.Tensor | None = None  # (N, T) standardised; None in inference

    @classmethod
    def of(cls, distance: np.ndarray, weight: np.ndarray, views: np.ndarray, membrane: np.ndarray,
           targets: torch.Tensor | None = None) -> "Batch":
        """Batch of :func:`compressed` maps; ``views`` and ``membrane`` as for :func:`known_of`."""
        return cls(torch.from_numpy(distance).float(), torch.from_numpy(weight) * WEIGHT_UNIT,
                   known_of(torch.from_numpy(views), torch.from_numpy(membrane)), targets)

    def turned(self, symmetry: Symmetry) -> "Batch":
        """The batch with ``symmetry`` applied to its maps, not to its targets."""
        return replace(self, distance=symmetry.of_maps(self.distance),
                       weight=symmetry.of_maps(self.weight))

    def through(self, network: torch.nn.Module) -> Mixture:
        """The network's posterior, on its device."""
        device = next(network.parameters()).device
        return network(*(part.to(device) for part in (self.distance, self.weight, self.known)))


class CircularConv(torch.nn.Conv2d):
    """3 x 3 convolution of maps (N, C, elevations, azimuths), circular in azimuth."""

    def __init__(self, inputs: int, outputs: int, stride: int = 1) -> None:
        super().__init__(inputs, outputs, 3, stride=stride, bias=False)

    def forward(self, maps: torch.Tensor) -> torch.Tensor:
        around = pad(pad(maps, (1, 1, 0, 0), mode="circular"), (0, 0, 1, 1))
        return torch.nn.functional.conv2d(around, self.weight, self.bias, self.stride)


class BasicBlock(torch.nn.Module):
    """Residual block of ResNet-18 (He et al. 2016, section 4.1)."""

    def __init__(self, inputs: int, outputs: int, stride: int) -> None:
        super().__init__()
        self.conv1, self.bn1 = CircularConv(inputs, outputs, stride), torch.nn.BatchNorm2d(outputs)
        self.conv2, self.bn2 = CircularConv(outputs, outputs), torch.nn.BatchNorm2d(outputs)
        self.downsample: torch.nn.Module = torch.nn.Identity()
        if stride != 1 or inputs != outputs:
            self.downsample = torch.nn.Sequential(
                torch.nn.Conv2d(inputs, outputs, 1, stride=stride, bias=False),
                torch.nn.BatchNorm2d(outputs))

    def forward(self, maps: torch.Tensor) -> torch.Tensor:
        residual = self.bn2(self.conv2(self.bn1(self.conv1(maps)).relu()))
        return (residual + self.downsample(maps)).relu()


class MapNet(torch.nn.Module):
    """Network from maps of distances and weights to a mixture of ``components`` Gaussians.

    ``width``: features of the first stage, 64 in ResNet-18; ``distance``, ``spread``: m, mean and
    standard deviation of the training distances.
    """

    def __init__(
        self, *, width: int, components: int, targets: int, distance: float, spread: float
    ) -> None:
        super().__init__()
        self.distance, self.spread = distance, spread
        widths = [width, width, 2 * width, 4 * width, 8 * width]
        self.stem = torch.nn.Sequential(
            CircularConv(CHANNELS, width, stride=2), torch.nn.BatchNorm2d(width), torch.nn.ReLU())
        self.stages = torch.nn.Sequential(*(
            torch.nn.Sequential(BasicBlock(before, after, stride=2 if k else 1),
                                BasicBlock(after, after, stride=1))
            for k, (before, after) in enumerate(pairwise(widths))))
        self.shape = {"components": components, "targets": targets}
        features = widths[-1] * (1 + 2 * len(_HARMONICS)) + KNOWN
        self.head = torch.nn.Sequential(
            torch.nn.Linear(features, 256), torch.nn.ReLU(),
            torch.nn.Linear(256, outputs_of(**self.shape)))

    def forward(self, distance: MapTensor, weight: MapTensor, known: torch.Tensor) -> Mixture:
        """The posterior of a :class:`Batch`, whose ``known`` is (N, KNOWN)."""
        azimuth = (torch.arange(AZIMUTHS) + 0.5) * (2 * torch.pi / AZIMUTHS)
        place = torch.stack([torch.cos(2 * azimuth), torch.sin(2 * azimuth)])
        place = place[None, :, None, :].expand(len(distance), 2, distance.shape[2], AZIMUTHS)
        maps = torch.stack([(distance.transpose(1, 2) - self.distance) / self.spread,
                            weight.transpose(1, 2).clamp(max=4.0) - 1.0], dim=1)
        features = self.stages(self.stem(torch.cat([maps, place.to(maps)], dim=1))).mean(dim=2)
        angle = (torch.arange(features.shape[2]) + 0.5) * (2 * torch.pi / features.shape[2])
        waves = [torch.ones_like(angle)]
        for harmonic in _HARMONICS:
            waves += [torch.cos(harmonic * angle), torch.sin(harmonic * angle)]
        pooled = features @ torch.stack(waves, dim=1).to(features) / features.shape[2]
        return self.posterior(self.head(torch.cat([pooled.flatten(1), known], dim=1)))

    def posterior(self, outputs: torch.Tensor) -> Mixture:
        """The posterior of the head's outputs (N, O)."""
        return Mixture.of_outputs(outputs, **self.shape)
