"""Networks with different inputs and outputs, for comparisons in studies.

Every answer has ``log_likelihood(targets)``, whose mean is maximised, and ``mean``, standardised
like the targets.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Protocol

import torch
import torchvision
from torch import nn

from drapenet.canonical import elevations
from drapenet.network import KNOWN, MapNet
from drapenet.posterior import Mixture, outputs_of
from sim.scene import Rig

COMPONENTS = 2  # of a posterior
_CLASSES_FROM, _CLASSES_TO = -2.5, 2.5  # standardised targets between which classes divide a range
_ROWS = 4  # of the map that shows an outline: the network halves them twice
_RADIUS, _HEIGHT = (0.09, 0.025), (-0.06, 0.03)  # m, usual values and deviations of a hem
_FOLD = 5  # azimuths on either side, over which a fold is a maximum of the radius


class Answer(Protocol):
    """A distribution, or an estimate, of standardised targets (N, T)."""

    def log_likelihood(self, targets: torch.Tensor) -> torch.Tensor:
        """Of targets (N, T); its mean is maximised."""

    @property
    def mean(self) -> torch.Tensor:
        """(N, T)."""


@dataclass(frozen=True)
class Regression:
    """Estimates (N, T) that are trained by their error alone (002, Eq. 10)."""

    mean: torch.Tensor

    def log_likelihood(self, targets: torch.Tensor) -> torch.Tensor:
        """The negative of Eq. 10: the root of the batch's mean squared error, a scalar."""
        return -(targets - self.mean).square().sum(dim=1).mean().sqrt()


@dataclass(frozen=True)
class Classes:
    """Shares of K classes of equal width for each target (002, section 6.2), logits (N, T, K)."""

    logits: torch.Tensor

    def log_likelihood(self, targets: torch.Tensor) -> torch.Tensor:
        """(N,) of the classes that targets (N, T) fall in."""
        count = self.logits.shape[-1]
        place = (targets - _CLASSES_FROM) * (count / (_CLASSES_TO - _CLASSES_FROM))
        chosen = place.long().clamp(0, count - 1)
        return self.logits.log_softmax(dim=-1).gather(2, chosen[..., None])[..., 0].sum(dim=1)

    @property
    def _middles(self) -> torch.Tensor:
        count = self.logits.shape[-1]
        return _CLASSES_FROM + (torch.arange(count) + 0.5) * (_CLASSES_TO - _CLASSES_FROM) / count

    @property
    def mean(self) -> torch.Tensor:
        """(N, T) the middle of the likeliest class."""
        return self._middles[self.logits.argmax(dim=-1)]


def head(name: str, targets: int) -> tuple[int, Callable[[torch.Tensor], Answer]]:
    """How many outputs a network has for the answer ``name``, and what turns them into it.

    Args:
        name: "posterior", "regression", or "classes K" for K classes.
    """
    if name == "posterior":
        shape = {"components": COMPONENTS, "targets": targets}
        return outputs_of(**shape), partial(Mixture.of_outputs, **shape)
    if name == "regression":
        return targets, Regression
    count = int(name.removeprefix("classes "))
    return targets * count, lambda outputs: Classes(outputs.view(len(outputs), targets, count))


class OnMaps(MapNet):
    """``MapNet`` with another output, see :func:`head`."""

    def __init__(self, *, answer: str, **shape: float) -> None:
        super().__init__(**shape)
        outputs, self.posterior = head(answer, int(shape["targets"]))
        self.head[-1] = nn.Linear(self.head[-1].in_features, outputs)


class OnOutlines(OnMaps):
    """The same network with radius and height of the hem by azimuth as input."""

    def __init__(self, *, rig: Rig, **shape: float) -> None:
        super().__init__(**shape)
        self.outline = Outline(rig)

    def forward(
        self, distance: torch.Tensor, weight: torch.Tensor, known: torch.Tensor
    ) -> Answer:
        """As for ``MapNet``."""
        radius, height = self.outline(distance, weight)
        radius = self.distance + self.spread * (radius - _RADIUS[0]) / _RADIUS[1]
        height = 1 + (height - _HEIGHT[0]) / _HEIGHT[1]
        shown = (part[..., None].expand(-1, -1, _ROWS) for part in (radius, height))
        return super().forward(*shown, known)


class Outline:
    """The hem of a drape on ``rig``, from its map."""

    def __init__(self, rig: Rig) -> None:
        borders = torch.from_numpy(elevations(rig)).float()
        self.elevation = (borders[1:] + borders[:-1]) / 2
        self.rig = rig

    def __call__(
        self, distance: torch.Tensor, weight: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """(N, AZIMUTHS) largest radius and height of the lowest cloth, m, from maps as the network
        gets them; of directions in which nothing was seen the plate's radius.
        """
        seen = weight > 0
        radius = torch.where(seen, distance * self.elevation.cos(), self.rig.plate_radius)
        lowest = seen.int().argmax(dim=2, keepdim=True)
        return radius.amax(dim=2), (distance * self.elevation.sin()).gather(2, lowest)[..., 0]


class OnNumbers(nn.Module):
    """Drape coefficient and number of folds, as textile laboratories count them."""

    def __init__(self, *, rig: Rig, answer: str, targets: int) -> None:
        super().__init__()
        self.outline = Outline(rig)
        outputs, self.posterior = head(answer, targets)
        self.layers = nn.Sequential(nn.Linear(2 + KNOWN, 64), nn.ReLU(), nn.Linear(64, 64),
                                    nn.ReLU(), nn.Linear(64, outputs))

    def forward(
        self, distance: torch.Tensor, weight: torch.Tensor, known: torch.Tensor
    ) -> Answer:
        """As for ``MapNet``."""
        radius, _ = self.outline(distance, weight)
        rig = self.outline.rig
        plate = torch.pi * rig.plate_radius**2
        coefficient = (torch.pi * radius.square().mean(dim=1) - plate) / (rig.specimen_area - plate)
        around = nn.functional.pad(radius[:, None], (_FOLD, _FOLD), mode="circular")
        largest = nn.functional.max_pool1d(around, 2 * _FOLD + 1, stride=1)[:, 0] == radius
        folds = (largest & ~largest.roll(1, dims=1)).sum(dim=1)  # equal neighbours count once
        numbers = torch.stack([10 * coefficient - 2, folds / 2 - 3], dim=1)
        return self.posterior(self.layers(torch.cat([numbers, known], dim=1)))


class OnViews(nn.Module):
    """Network of torchvision with images (N, channels, H, W) of all views as input."""

    def __init__(self, name: str, *, channels: int, answer: str, targets: int) -> None:
        super().__init__()
        outputs, self.posterior = head(answer, targets)
        self.network = torchvision.models.get_model(name, num_classes=outputs)
        place, first = next((key, part) for key, part in self.network.named_modules()
                            if isinstance(part, nn.Conv2d))
        self.network.set_submodule(place, nn.Conv2d(
            channels, first.out_channels, first.kernel_size, first.stride, first.padding,
            bias=first.bias is not None))
        self.larger = 2 if name == "alexnet" else 1  # it pools 80 x 60 pixels to nothing

    def forward(self, pictures: torch.Tensor) -> Answer:
        """Of pictures (N, channels, H, W)."""
        if self.larger > 1:
            pictures = nn.functional.interpolate(pictures, scale_factor=self.larger)
        return self.posterior(self.network(pictures))
