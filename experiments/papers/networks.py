"""Networks with different inputs and outputs, and captures as stacked depth views for some of them.

All networks return a :class:`Prediction` of standardised targets.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Protocol

import numpy as np
import torch
import torchvision
from torch import nn

from common.types import Views
from data.dataset.shards import Shard
from data.render.cameras import nominal_camera
from data.render.setups import Setups
from drapenet.network.dataset import Maps
from drapenet.network.model import KNOWN, MapNet
from drapenet.network.posterior import Mixture, outputs_of
from drapenet.network.targets import MODULI, Symmetry, TargetScale, targets_of
from drapenet.network.training import CaptureSet
from drapenet.views.directions import AZIMUTHS, elevations
from sim.rig import Rig

COMPONENTS = 2  # of a posterior
_CLASS_MIN, _CLASS_MAX = -2.5, 2.5  # range of standardised targets that is divided into classes
_OUTLINE_ROWS = 4  # rows of a map that repeats an outline; the network halves them twice
_RADIUS, _HEIGHT = (0.09, 0.025), (-0.06, 0.03)  # m, typical mean and standard deviation
_FOLD_WINDOW = 5  # half width, in azimuths, of the window in which a fold is the maximum radius
VIEW_SHARES = (0.0, 0.0, 0.0, 1.0)  # shares of captures with 1, 2, ... views
BLOCK = 3  # from 240 x 180 to 80 x 60 pixels
CENTRE, SCALE, BACKGROUND = 0.55, 0.1, 2.0  # m, m, scaled depth far behind the cloth
CHANNELS = 5  # four views and the focal length
TARGETS = MODULI + 2  # those of a disc
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


def output_head(name: str, targets: int) -> tuple[int, Callable[[torch.Tensor], Prediction]]:
    """Number of outputs of a network and their conversion into a :class:`Prediction`, by name:
    posterior, regression, or "classes K" for K classes."""
    if name == "posterior":
        shape = {"components": COMPONENTS, "targets": targets}
        return outputs_of(**shape), partial(Mixture.of_outputs, **shape)
    if name == "regression":
        return targets, Regression
    count = int(name.removeprefix("classes "))
    return targets * count, lambda outputs: Classes(outputs.view(len(outputs), targets, count))


class MapNetwork(MapNet):
    """``MapNet`` with another output, see :func:`output_head`."""

    def __init__(self, *, output: str, **shape: float) -> None:
        super().__init__(**shape)
        outputs, self.posterior = output_head(output, int(shape["targets"]))
        self.head[-1] = nn.Linear(self.head[-1].in_features, outputs)


class OutlineNetwork(MapNetwork):
    """``MapNetwork`` with radius and height of the hem by azimuth as input."""

    def __init__(self, *, rig: Rig, **shape: float) -> None:
        super().__init__(**shape)
        self.outline = Outline(rig)

    def forward(
        self, distance: torch.Tensor, weight: torch.Tensor, known: torch.Tensor
    ) -> Prediction:
        """As for ``MapNet``."""
        radius, height = self.outline(distance, weight)
        radius = self.distance + self.spread * (radius - _RADIUS[0]) / _RADIUS[1]
        height = 1 + (height - _HEIGHT[0]) / _HEIGHT[1]
        inputs = (part[..., None].expand(-1, -1, _OUTLINE_ROWS) for part in (radius, height))
        return super().forward(*inputs, known)


class Outline:
    """Hem of a drape on ``rig``, computed from its map."""

    def __init__(self, rig: Rig) -> None:
        borders = torch.from_numpy(elevations(rig)).float()
        self.elevation = (borders[1:] + borders[:-1]) / 2
        self.rig = rig

    def __call__(
        self, distance: torch.Tensor, weight: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Largest radius and height of the lowest point (N, AZIMUTHS) each, m, from input maps of
        the network. Azimuths without data have the plate's radius.
        """
        seen = weight > 0
        radius = torch.where(seen, distance * self.elevation.cos(), self.rig.plate_radius)
        lowest = seen.int().argmax(dim=2, keepdim=True)
        return radius.amax(dim=2), (distance * self.elevation.sin()).gather(2, lowest)[..., 0]


class FoldNetwork(nn.Module):
    """Network with drape coefficient and number of folds as input."""

    def __init__(self, *, rig: Rig, output: str, targets: int) -> None:
        super().__init__()
        self.outline = Outline(rig)
        outputs, self.posterior = output_head(output, targets)
        self.layers = nn.Sequential(nn.Linear(2 + KNOWN, 64), nn.ReLU(), nn.Linear(64, 64),
                                    nn.ReLU(), nn.Linear(64, outputs))

    def forward(
        self, distance: torch.Tensor, weight: torch.Tensor, known: torch.Tensor
    ) -> Prediction:
        """As for ``MapNet``."""
        radius, _ = self.outline(distance, weight)
        rig = self.outline.rig
        plate = torch.pi * rig.plate_radius**2
        coefficient = (torch.pi * radius.square().mean(dim=1) - plate) / (rig.specimen_area - plate)
        around = nn.functional.pad(radius[:, None], (_FOLD_WINDOW, _FOLD_WINDOW), mode="circular")
        largest = nn.functional.max_pool1d(around, 2 * _FOLD_WINDOW + 1, stride=1)[:, 0] == radius
        folds = (largest & ~largest.roll(1, dims=1)).sum(dim=1)  # count plateaus once
        numbers = torch.stack([10 * coefficient - 2, folds / 2 - 3], dim=1)
        return self.posterior(self.layers(torch.cat([numbers, known], dim=1)))


class ViewNetwork(nn.Module):
    """Network of torchvision with images (N, channels, H, W) of all views as input."""

    def __init__(self, name: str, *, channels: int, output: str, targets: int) -> None:
        super().__init__()
        outputs, self.posterior = output_head(output, targets)
        self.network = torchvision.models.get_model(name, num_classes=outputs)
        position, first = next((key, part) for key, part in self.network.named_modules()
                            if isinstance(part, nn.Conv2d))
        self.network.set_submodule(position, nn.Conv2d(
            channels, first.out_channels, first.kernel_size, first.stride, first.padding,
            bias=first.bias is not None))
        self.upsampling = 2 if name == "alexnet" else 1  # pooling reduces 80 x 60 pixels to 0

    def forward(self, images: torch.Tensor) -> Prediction:
        """Prediction from images (N, channels, H, W)."""
        if self.upsampling > 1:
            images = nn.functional.interpolate(images, scale_factor=self.upsampling)
        return self.posterior(self.network(images))


# --- Stacked views --------------------------------------------------------------------------


def setups(*, fixed: bool = False) -> Setups:
    """Set-ups of training with four views; with ``fixed``, all specimens in one orientation."""
    return replace(Setups.load(), views=VIEW_SHARES, **(
        {"orientation": (-FIXED_RANGE, FIXED_RANGE)} if fixed else {}))


def capture_views(
    shard: str, rig: str, captures: int, seed: int, dataset: str, fixed: bool
) -> dict:
    """Capture a shard as :func:`drapenet.network.dataset.make_maps` does, and store the views as
    arrays.

    ``views`` (N, 4, 60, 80) float16, see :func:`downsample`; ``focal`` (N,), relative to the
    nominal focal length, less 1; ``orientation`` (N,) of the warp in the first view, rad.
    ``dataset`` is the digest of the drapes, a part of the key of the stored result.
    """
    distribution, tester = setups(fixed=fixed), Rig.from_name(rig)
    nominal = nominal_camera(tester)
    views, focal, orientation = [], [], []
    drapes = Shard(shard)
    index = drapes.column("index")
    for row in np.flatnonzero(drapes.column("status") == "converged"):
        positions, _, faces = drapes.mesh(row)
        for number in range(captures):
            rng = np.random.default_rng([seed, int(index[row]), number])  # as in make_maps
            capture = distribution.capture(positions, faces, rng, rig=tester)
            views.append(downsample(capture.views))
            focal.append(capture.intrinsics.fx / nominal.fx - 1)
            orientation.append(capture.orientation)
    return {"dataset": dataset, "arrays": {
        "views": np.array(views).reshape(len(focal), 4, -1, nominal.width // BLOCK),
        "focal": np.array(focal), "orientation": np.array(orientation)}}


def downsample(views: Views) -> np.ndarray:
    """Scaled means (K, H/3, W/3) float16 of blocks that are mostly cloth."""
    blocks = views.reshape(len(views), views.shape[1] // BLOCK, BLOCK, -1, BLOCK)
    cloth = (blocks > 0).sum(axis=(2, 4))
    depth = blocks.sum(axis=(2, 4)) / np.maximum(cloth, 1)
    return np.where(2 * cloth > BLOCK**2, (depth - CENTRE) / SCALE, BACKGROUND).astype(np.float16)


def apply_symmetry(views: torch.Tensor, symmetry: Symmetry) -> torch.Tensor:
    """Views (N, 4, H, W) of the specimens after ``symmetry``, in quarter turns."""
    order = torch.arange(4) + symmetry.cells[:, None] // (AZIMUTHS // 4)
    order = torch.where(symmetry.mirror[:, None], -order, order) % 4
    views = views[torch.arange(len(views))[:, None], order]
    return torch.where(symmetry.mirror[:, None, None, None], views.flip(-1), views)


@dataclass(frozen=True)
class StackedBatch:
    """Images (N, 5, H, W) and standardised targets (N, 8)."""

    images: torch.Tensor
    targets: torch.Tensor

    def through(self, network: torch.nn.Module) -> Prediction:
        """Prediction of the network."""
        return network(self.images)


class StackedSet(CaptureSet):
    """Stacked views of captures (:func:`capture_views`) and their maps, with the standardised
    targets of a disc for all specimens."""

    def __init__(self, maps: Maps, views: np.ndarray, focal: np.ndarray, orientation: np.ndarray,
                 *, scale: TargetScale | None = None) -> None:
        self.maps, self.disc = maps, False  # quarter turns are the only rotations
        self.views, self.focal = torch.from_numpy(views), torch.from_numpy(focal).float()
        targets = targets_of(maps.theta, orientation, disc=True)
        self.scale = scale or TargetScale.fit(targets, disc=True)
        self.targets = torch.from_numpy(self.scale.encode(targets)).float()

    def batch(
        self, rows: np.ndarray, *, revealed: np.ndarray, symmetry: Symmetry | None = None
    ) -> StackedBatch:
        """Batch of the captures ``rows``; ``revealed`` is ignored."""
        views, targets = self.views[rows].float(), self.targets[rows]
        if symmetry is not None:
            views = apply_symmetry(views, symmetry)
            targets = symmetry.of_targets(targets, disc=True)
        focal = self.focal[rows, None, None, None].expand(-1, 1, *views.shape[2:])
        return StackedBatch(torch.cat([views, focal], dim=1), targets)
