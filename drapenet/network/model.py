"""ResNet-18 on maps of drapes, with circular padding in azimuth."""

from dataclasses import dataclass, replace

import numpy as np
import torch
import torchvision
from torch.nn.functional import pad

from drapenet.network.dataset import WEIGHT_UNIT
from drapenet.network.posterior import Mixture, outputs_of
from drapenet.network.targets import Symmetry
from drapenet.views.radial_map import AZIMUTHS

CHANNELS = 4
"""Distance, weight, cosine and sine of twice the azimuth, which encode the origin of azimuths."""
KNOWN = 5
"""Number of scalar inputs, see :func:`known_of`."""
_HARMONICS = (2, 4)  # of the azimuth, for pooling features beside their mean
_MEMBRANE = 316.0  # N/m, unit of the input
_NO_FRICTION = (1.0, -1.0)
"""Two inputs of the bundled networks, trained with friction beside the moduli: there is none, as
the moduli are those of the loading curve."""


def known_of(views: torch.Tensor, membrane: torch.Tensor) -> torch.Tensor:
    """(N, KNOWN) float32 scalar inputs of the network.

    Args:
        views: (N,) number of views of the map.
        membrane: (N,) N/m along the yarns, NaN if unknown.
    """
    given, value = torch.isfinite(membrane), torch.log(membrane / _MEMBRANE)
    constants = [torch.full(views.shape, number) for number in _NO_FRICTION]
    return torch.stack([views.float() / 4 - 1, given.float(),
                        torch.where(given, value, 0.0).float(), *constants], dim=1)


@dataclass(frozen=True)
class Batch:
    """Inputs of the network for N captures, and targets.

    Attributes:
        distance, weight: (N, AZIMUTHS, ELEVATIONS) float32, m and logarithm of 1 + weight.
        known: (N, KNOWN), see :func:`known_of`.
        targets: (N, T) standardised; None in inference.
    """

    distance: torch.Tensor
    weight: torch.Tensor
    known: torch.Tensor
    targets: torch.Tensor | None = None

    @classmethod
    def of(cls, distance: np.ndarray, weight: np.ndarray, views: np.ndarray, given: np.ndarray,
           targets: torch.Tensor | None = None) -> "Batch":
        """Batch of maps in the types of :class:`drapenet.network.dataset.Maps`.

        Args:
            given: (N,) membrane, N/m along the yarns; NaN if unknown.
        """
        return cls(torch.from_numpy(distance).float(), torch.from_numpy(weight) * WEIGHT_UNIT,
                   known_of(torch.from_numpy(views), torch.from_numpy(given)), targets)

    def turned(self, symmetry: Symmetry) -> "Batch":
        """The batch with ``symmetry`` applied to its maps, not to its targets."""
        return replace(self, distance=symmetry.of_maps(self.distance),
                       weight=symmetry.of_maps(self.weight))

    def through(self, network: torch.nn.Module) -> Mixture:
        """The network's posterior, on its device."""
        device = next(network.parameters()).device
        return network(*(part.to(device) for part in (self.distance, self.weight, self.known)))


class CircularConv(torch.nn.Conv2d):
    """Convolution of maps (N, C, elevations, azimuths) with circular padding in azimuth."""

    def forward(self, maps: torch.Tensor) -> torch.Tensor:
        rows, columns = self.kernel_size[0] // 2, self.kernel_size[1] // 2
        maps = pad(pad(maps, (columns, columns, 0, 0), mode="circular"), (0, 0, rows, rows))
        return torch.nn.functional.conv2d(maps, self.weight, self.bias, self.stride)


class MapNet(torch.nn.Module):
    """Network from maps (N, AZIMUTHS, ELEVATIONS) of distances and weights to a mixture.

    Args:
        width: features of the first stage; 64 as in ResNet-18.
        components: of the mixture.
        targets: their number, see :mod:`drapenet.network.targets`.
        distance, spread: m, mean and standard deviation of the training distances.
    """

    def __init__(
        self, *, width: int, components: int, targets: int, distance: float, spread: float
    ) -> None:
        super().__init__()
        self.distance, self.spread = distance, spread
        block = torchvision.models.resnet.BasicBlock
        network = torchvision.models.ResNet(block, [2, 2, 2, 2])
        widths = [width, 2 * width, 4 * width, 8 * width]
        network.inplanes = width
        self.stem = torch.nn.Sequential(
            torch.nn.Conv2d(CHANNELS, width, 3, stride=2, padding=1, bias=False),
            torch.nn.BatchNorm2d(width), torch.nn.ReLU(inplace=True))
        self.stages = torch.nn.Sequential(*(
            network._make_layer(block, planes, 2, stride=1 if k == 0 else 2)
            for k, planes in enumerate(widths)))
        _make_circular(self)
        self.shape = {"components": components, "targets": targets}
        features = widths[-1] * (1 + 2 * len(_HARMONICS)) + KNOWN
        self.head = torch.nn.Sequential(
            torch.nn.Linear(features, 256), torch.nn.ReLU(inplace=True),
            torch.nn.Linear(256, outputs_of(**self.shape)))

    def forward(
        self, distance: torch.Tensor, weight: torch.Tensor, known: torch.Tensor
    ) -> Mixture:
        """Distance (N, AZIMUTHS, ELEVATIONS), m; weight, the logarithm of 1 + the map's; known."""
        azimuth = (torch.arange(AZIMUTHS) + 0.5) * (2 * torch.pi / AZIMUTHS)
        where = torch.stack([torch.cos(2 * azimuth), torch.sin(2 * azimuth)])
        where = where[None, :, None, :].expand(len(distance), 2, distance.shape[2], AZIMUTHS)
        maps = torch.stack([(distance.transpose(1, 2) - self.distance) / self.spread,
                            weight.transpose(1, 2).clamp(max=4.0) - 1.0], dim=1)
        found = self.stages(self.stem(torch.cat([maps, where.to(maps)], dim=1)))
        around = found.mean(dim=2)
        angle = (torch.arange(around.shape[2]) + 0.5) * (2 * torch.pi / around.shape[2])
        waves = [torch.ones_like(angle)]
        for harmonic in _HARMONICS:
            waves += [torch.cos(harmonic * angle), torch.sin(harmonic * angle)]
        pooled = around @ torch.stack(waves, dim=1).to(around) / around.shape[2]
        return self.posterior(self.head(torch.cat([pooled.flatten(1), known], dim=1)))

    def posterior(self, outputs: torch.Tensor) -> Mixture:
        """The posterior of the head's outputs (N, :func:`outputs_of`)."""
        return Mixture.of_outputs(outputs, **self.shape)


def _make_circular(module: torch.nn.Module) -> None:
    """Replace all convolutions within ``module`` by circular ones."""
    for name, child in module.named_children():
        if isinstance(child, torch.nn.Conv2d) and child.kernel_size[0] > 1:
            around = CircularConv(child.in_channels, child.out_channels, child.kernel_size,
                                stride=child.stride, bias=child.bias is not None)
            around.load_state_dict(child.state_dict())
            setattr(module, name, around)
        else:
            _make_circular(child)
