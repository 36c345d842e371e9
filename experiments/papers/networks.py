"""Networks with different inputs and outputs, and captures of the square tester as their inputs.

All networks return a :class:`Prediction` of theta, standardised, with the stiffer yarns first.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import pairwise
from typing import Protocol

import numpy as np
import torch
import torchvision
from torch import nn
from torchvision.models import resnet

from common.types import Theta, Views
from data.dataset.shards import Shard
from data.render.cameras import nominal_camera
from data.render.setups import Setups
from drapenet.network.model import POOLED, MapTensor, pooled
from drapenet.network.posterior import Mixture, outputs_of
from drapenet.network.targets import MODULI, Symmetry, TargetScale
from drapenet.views.directions import AZIMUTHS, elevations
from drapenet.views.radial_map import WEIGHT_UNIT
from experiments.drapes import RIG
from sim.material import FIRST, SECOND, SWAPPED

COMPONENTS = 2  # of a posterior
_MAP_CHANNELS = 4  # distance, weight, cosine and sine of twice the azimuth
_CLASS_MIN, _CLASS_MAX = -2.5, 2.5  # range of standardised targets that is divided into classes
_OUTLINE_ROWS = 4  # rows of a map that repeats an outline; the network halves them twice
_RADIUS, _HEIGHT = (0.09, 0.025), (-0.06, 0.03)  # m, typical mean and standard deviation
_FOLD_WINDOW = 5  # half width, in azimuths, of the window in which a fold is the maximum radius
VIEW_SHARES = (0.0, 0.0, 0.0, 1.0)  # shares of captures with 1, 2, ... views
BLOCK = 3  # from 240 x 180 to 80 x 60 pixels
CENTRE, SCALE, BACKGROUND = 0.55, 0.1, 2.0  # m, m, scaled depth far behind the cloth
CHANNELS = 5  # four views and the focal length
FIXED_RANGE = np.radians(10.0)  # largest angle of the warp where the orientation is fixed


class Prediction(Protocol):
    """Distribution or point estimate of standardised targets (N, T)."""

    def log_likelihood(self, targets: torch.Tensor) -> torch.Tensor:
        """Log likelihood (N,) or () of targets (N, T); training maximises its mean."""

    @property
    def mean(self) -> torch.Tensor:
        """Estimates (N, T)."""


@dataclass(frozen=True)
class Regression:
    """Point estimates (N, T), trained by the loss of 002, Eq. 10."""

    mean: torch.Tensor

    def log_likelihood(self, targets: torch.Tensor) -> torch.Tensor:
        """Negative loss of Eq. 10, the root of the batch's mean squared error, a scalar."""
        return -(targets - self.mean).square().sum(dim=1).mean().sqrt()


@dataclass(frozen=True)
class Classes:
    """Logits (N, T, K) of K classes of equal width for each target (002, section 6.2)."""

    logits: torch.Tensor

    def log_likelihood(self, targets: torch.Tensor) -> torch.Tensor:
        """Log likelihood (N,) of the classes of targets (N, T)."""
        count = self.logits.shape[-1]
        position = (targets - _CLASS_MIN) * (count / (_CLASS_MAX - _CLASS_MIN))
        chosen = position.long().clamp(0, count - 1)
        return self.logits.log_softmax(dim=-1).gather(2, chosen[..., None])[..., 0].sum(dim=1)

    @property
    def _centres(self) -> torch.Tensor:
        count = self.logits.shape[-1]
        return _CLASS_MIN + (torch.arange(count) + 0.5) * (_CLASS_MAX - _CLASS_MIN) / count

    @property
    def mean(self) -> torch.Tensor:
        """Centres (N, T) of the most probable classes."""
        return self._centres[self.logits.argmax(dim=-1)]


def output_head(
    name: str, targets: int = MODULI
) -> tuple[int, Callable[[torch.Tensor], Prediction]]:
    """Number of outputs of a network and their conversion into a :class:`Prediction`, by name:
    posterior, regression, or "classes K" for K classes."""
    if name == "posterior":
        shape = {"components": COMPONENTS, "targets": targets}
        return outputs_of(**shape), partial(Mixture.of_outputs, **shape)
    if name == "regression":
        return targets, Regression
    count = int(name.removeprefix("classes "))
    return targets * count, lambda outputs: Classes(outputs.view(len(outputs), targets, count))


# --- Networks -------------------------------------------------------------------------------


class CircularConv(nn.Conv2d):
    """3 x 3 convolution of maps (N, C, elevations, azimuths), circular in azimuth."""

    def __init__(self, inputs: int, outputs: int, stride: int = 1) -> None:
        super().__init__(inputs, outputs, 3, stride=stride, padding=(1, 0), bias=False)

    def forward(self, maps: torch.Tensor) -> torch.Tensor:
        return super().forward(nn.functional.pad(maps, (1, 1, 0, 0), mode="circular"))


class CircularBlock(resnet.BasicBlock):
    """Residual block of ResNet-18 with :class:`CircularConv`."""

    def __init__(self, inputs: int, outputs: int, stride: int) -> None:
        shortcut = None if stride == 1 else nn.Sequential(
            resnet.conv1x1(inputs, outputs, stride), nn.BatchNorm2d(outputs))
        super().__init__(inputs, outputs, stride, shortcut)
        self.conv1 = CircularConv(inputs, outputs, stride)
        self.conv2 = CircularConv(outputs, outputs)


class MapNetwork(nn.Module):
    """ResNet-18 on maps of distances, m, and weights.

    ``width``: features of the first stage, 64 in ResNet-18; ``distance``, ``spread``: m, mean and
    standard deviation of the training distances.
    """

    def __init__(self, width: int, *, output: str, distance: float, spread: float) -> None:
        super().__init__()
        self.distance, self.spread = distance, spread
        widths = [width, width, 2 * width, 4 * width, 8 * width]
        self.stem = nn.Sequential(
            CircularConv(_MAP_CHANNELS, width, stride=2), nn.BatchNorm2d(width), nn.ReLU())
        self.stages = nn.Sequential(*(
            nn.Sequential(CircularBlock(before, after, stride=2 if k else 1),
                          CircularBlock(after, after, stride=1))
            for k, (before, after) in enumerate(pairwise(widths))))
        outputs, self.posterior = output_head(output)
        self.head = nn.Sequential(
            nn.Linear(POOLED * widths[-1], 256), nn.ReLU(), nn.Linear(256, outputs))

    def forward(self, distance: MapTensor, weight: MapTensor) -> Prediction:
        """Prediction from maps, of weights the logarithms of 1 + weight."""
        angle = (torch.arange(AZIMUTHS) + 0.5) * (4 * torch.pi / AZIMUTHS)
        place = torch.stack([torch.cos(angle), torch.sin(angle)])[None, :, None, :]
        maps = torch.stack([(distance.transpose(1, 2) - self.distance) / self.spread,
                            weight.transpose(1, 2).clamp(max=4.0) - 1.0], dim=1)
        maps = torch.cat([maps, place.expand(len(maps), 2, *maps.shape[2:])], dim=1)
        return self.posterior(self.head(pooled(self.stages(self.stem(maps)).mean(dim=2))))


class OutlineNetwork(MapNetwork):
    """``MapNetwork`` with radius and height of the hem by azimuth as input."""

    def forward(self, distance: MapTensor, weight: MapTensor) -> Prediction:
        """As for ``MapNetwork``."""
        radius, height = outline(distance, weight)
        radius = self.distance + self.spread * (radius - _RADIUS[0]) / _RADIUS[1]
        height = 1 + (height - _HEIGHT[0]) / _HEIGHT[1]
        return super().forward(*(part[..., None].expand(-1, -1, _OUTLINE_ROWS)
                                 for part in (radius, height)))


def outline(distance: MapTensor, weight: MapTensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Largest radius and height of the lowest point (N, AZIMUTHS) each, m, of maps as for
    ``MapNetwork``. Azimuths without data have the plate's radius.
    """
    borders = torch.from_numpy(elevations(RIG)).float()
    elevation, seen = (borders[1:] + borders[:-1]) / 2, weight > 0
    radius = torch.where(seen, distance * elevation.cos(), RIG.plate_radius)
    lowest = seen.int().argmax(dim=2, keepdim=True)
    return radius.amax(dim=2), (distance * elevation.sin()).gather(2, lowest)[..., 0]


class FoldNetwork(nn.Module):
    """Network with drape coefficient and number of folds as input."""

    def __init__(self, output: str) -> None:
        super().__init__()
        outputs, self.posterior = output_head(output)
        self.layers = nn.Sequential(nn.Linear(2, 64), nn.ReLU(), nn.Linear(64, 64), nn.ReLU(),
                                    nn.Linear(64, outputs))

    def forward(self, distance: MapTensor, weight: MapTensor) -> Prediction:
        """As for ``MapNetwork``."""
        radius, _ = outline(distance, weight)
        plate = torch.pi * RIG.plate_radius**2
        coefficient = (torch.pi * radius.square().mean(dim=1) - plate) / (RIG.specimen_area - plate)
        around = nn.functional.pad(radius[:, None], (_FOLD_WINDOW, _FOLD_WINDOW), mode="circular")
        largest = nn.functional.max_pool1d(around, 2 * _FOLD_WINDOW + 1, stride=1)[:, 0] == radius
        folds = (largest & ~largest.roll(1, dims=1)).sum(dim=1)  # count plateaus once
        return self.posterior(self.layers(
            torch.stack([10 * coefficient - 2, folds / 2 - 3], dim=1)))


class ViewNetwork(nn.Module):
    """Network of torchvision with images (N, CHANNELS, H, W) of all views as input."""

    def __init__(self, name: str, *, output: str) -> None:
        super().__init__()
        outputs, self.posterior = output_head(output)
        self.network = torchvision.models.get_model(name, num_classes=outputs)
        position, first = next((key, part) for key, part in self.network.named_modules()
                            if isinstance(part, nn.Conv2d))
        self.network.set_submodule(position, nn.Conv2d(
            CHANNELS, first.out_channels, first.kernel_size, first.stride, first.padding,
            bias=first.bias is not None))
        self.upsampling = 2 if name == "alexnet" else 1  # pooling reduces 80 x 60 pixels to 0

    def forward(self, images: torch.Tensor) -> Prediction:
        """Prediction from images (N, CHANNELS, H, W)."""
        if self.upsampling > 1:
            images = nn.functional.interpolate(images, scale_factor=self.upsampling)
        return self.posterior(self.network(images))


# --- Captures -------------------------------------------------------------------------------


def stiff_first(theta: Theta) -> Theta:
    """Theta (N, 6) with the stiffer yarns first."""
    return np.where(theta[:, [FIRST]] < theta[:, [SECOND]], theta[:, SWAPPED], theta)


@dataclass(frozen=True)
class Batch:
    """Inputs of a network and standardised targets (N, 6)."""

    inputs: list[torch.Tensor]
    targets: torch.Tensor

    def through(self, network: nn.Module) -> Prediction:
        """Prediction of the network."""
        return network(*self.inputs)


@dataclass(frozen=True)
class CaptureSet:
    """N captures.

    Attributes:
        inputs: of the network, (N, ...) each.
        fabric: (N,) their numbers.
        turned: applies a symmetry in quarter turns to an input.
    """

    inputs: Sequence[torch.Tensor]
    theta: Theta
    fabric: np.ndarray
    scale: TargetScale
    turned: Callable[[Symmetry, torch.Tensor], torch.Tensor]

    def __len__(self) -> int:
        return len(self.theta)

    @classmethod
    def of_maps(
        cls, distance: np.ndarray, weight: np.ndarray, theta: Theta, fabric: np.ndarray,
        scale: TargetScale,
    ) -> "CaptureSet":
        """Compressed maps, see :class:`drapenet.network.dataset.Maps`."""
        metres = torch.from_numpy(distance).float() * RIG.specimen_size
        return cls((metres, torch.from_numpy(weight) * WEIGHT_UNIT), theta, fabric, scale,
                   Symmetry.of_rows)

    @classmethod
    def of_images(
        cls, images: np.ndarray, theta: Theta, fabric: np.ndarray, scale: TargetScale
    ) -> "CaptureSet":
        """Images of views, see :func:`image`."""
        return cls((torch.from_numpy(images),), theta, fabric, scale, turn_views)

    @cached_property
    def targets(self) -> torch.Tensor:
        """(N, 6) standardised theta with the stiffer yarns first."""
        return torch.from_numpy(self.scale.encode(stiff_first(self.theta))).float()

    def batch(self, rows: np.ndarray, symmetry: Symmetry | None = None) -> Batch:
        """The captures of ``rows`` (N,) after ``symmetry``."""
        inputs = [part[rows].float() for part in self.inputs]
        if symmetry is not None:
            inputs = [self.turned(symmetry, part) for part in inputs]
        return Batch(inputs, self.targets[rows])

    def in_order(self, size: int) -> Iterator[Batch]:
        """All captures in order, without symmetries."""
        for rows in np.array_split(np.arange(len(self)), -(-len(self) // size)):
            yield self.batch(rows)

    def epoch(self, *, seed: int, epoch: int, size: int, symmetric: bool) -> Iterator[Batch]:
        """Full batches in random order, if ``symmetric`` with random symmetries, a function of
        (seed, epoch)."""
        rng, square = np.random.default_rng([seed, epoch]), np.zeros(size, bool)
        order = rng.permutation(len(self))
        for start in range(0, len(self) - size + 1, size):
            symmetry = Symmetry.draw(known=square, disc=square, rng=rng) if symmetric else None
            yield self.batch(order[start : start + size], symmetry)


def setups(*, fixed: bool = False) -> Setups:
    """Set-ups of training with four views; with ``fixed``, all specimens in one orientation."""
    return replace(Setups.load(), views=VIEW_SHARES, **(
        {"orientation": (-FIXED_RANGE, FIXED_RANGE)} if fixed else {}))


def capture_views(shard: str, captures: int, seed: int, dataset: str, fixed: bool) -> dict:
    """Capture a shard as :func:`drapenet.network.dataset.make_maps` does; "arrays" has the images.

    ``dataset`` is the digest of the drapes, a part of the key of the stored result.
    """
    distribution, images = setups(fixed=fixed), []
    drapes = Shard(shard)
    index = drapes.column("index")
    for row in np.flatnonzero(drapes.column("status") == "converged"):
        positions, _, faces = drapes.mesh(row)
        for number in range(captures):
            rng = np.random.default_rng([seed, int(index[row]), number])  # as in make_maps
            rng.standard_normal()  # there the error of the stated warp
            capture = distribution.capture(positions, faces, rng, rig=RIG)
            images.append(image(capture.views, capture.intrinsics.fx))
    return {"dataset": dataset, "arrays": {"images": np.array(images)}}


def image(views: Views, fx: float) -> np.ndarray:
    """(CHANNELS, H/3, W/3) float16: four views, see :func:`downsample`, and the focal length,
    relative to the nominal one, less 1."""
    focal = np.float16(fx / nominal_camera(RIG).fx - 1)
    small = downsample(views)
    return np.concatenate([small, np.full((1, *small.shape[1:]), focal)])


def downsample(views: Views) -> np.ndarray:
    """Scaled means (K, H/3, W/3) float16 of blocks that are mostly cloth."""
    blocks = views.reshape(len(views), views.shape[1] // BLOCK, BLOCK, -1, BLOCK)
    cloth = (blocks > 0).sum(axis=(2, 4))
    depth = blocks.sum(axis=(2, 4)) / np.maximum(cloth, 1)
    return np.where(2 * cloth > BLOCK**2, (depth - CENTRE) / SCALE, BACKGROUND).astype(np.float16)


def turn_views(symmetry: Symmetry, images: torch.Tensor) -> torch.Tensor:
    """Images (N, CHANNELS, H, W) of the specimens after ``symmetry``, in quarter turns."""
    order = torch.arange(4) + symmetry.cells[:, None] // (AZIMUTHS // 4)
    order = torch.where(symmetry.mirror[:, None], -order, order) % 4
    views = images[torch.arange(len(images))[:, None], order]
    views = torch.where(symmetry.mirror[:, None, None, None], views.flip(-1), views)
    return torch.cat([views, images[:, 4:]], dim=1)
