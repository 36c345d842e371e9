"""The network and its input: a ResNet-18 over azimuth, and sets of captures.

A column of a map, the cloth at one azimuth, is a feature vector; convolutions run around the axis.

Each capture of a set is read alone, from its map, its outline, or its drape coefficient; features
of the captures are averaged with weights that the network gives them (after Zaheer et al. 2017,
Deep Sets), and the average, the mean of the weights and the number of captures give one posterior
of the fabric.
"""

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Annotated

import numpy as np
import torch
from torch.nn.functional import softplus

from drapenet.network.posterior import Mixture, outputs_of
from drapenet.network.targets import TARGETS, Symmetry
from drapenet.views.directions import AZIMUTHS, ELEVATIONS
from drapenet.views.radial_map import WEIGHT_UNIT

CHANNELS = 2 * ELEVATIONS + 5
"""Distances and weights of a column, outline, whether the outline is seen, cosine and sine of twice
and cosine of four times the azimuth."""
_HARMONICS = (2, 4)  # of the azimuth, for pooling features beside their mean
POOLED = 1 + 2 * len(_HARMONICS)  # values of a feature
_SIZE = 0.3  # m, unit of the specimens' size
_EMBEDDING = 256  # features of a capture

MapTensor = Annotated[torch.Tensor, "(N, AZIMUTHS, ELEVATIONS) float32"]


@dataclass(frozen=True)
class Facts:
    """What is known of N captures beside their pictures, (N,) each; NaN if it is not.

    Attributes:
        size: of the specimens, m.
        plate: diameter of the plate over the specimen's size.
        aspect: side across azimuth 0 over the side along it; 1 of squares and discs.
        known: whether the captures of its set have azimuth 0 along the warp (or, after a quarter
            turn, see :meth:`Batch.turned`, along the weft).
        views: their number in a depth capture, 0 without.
        perspective: size over the camera's height, of an outline; 0 under parallel light.
        coefficient: drape coefficient, from 0 to 1, of the outline or as reported.
        nodes: number of folds, as reported.
        group: number of the set, from 0.
    """

    size: np.ndarray
    plate: np.ndarray
    disc: np.ndarray
    aspect: np.ndarray
    face: np.ndarray  # 1, or -1 if turned over
    known: np.ndarray
    views: np.ndarray
    perspective: np.ndarray
    coefficient: np.ndarray
    nodes: np.ndarray
    group: np.ndarray

    @property
    def sizes(self) -> np.ndarray:
        """(M,) m, geometric means over the sets."""
        count = np.bincount(self.group)
        return np.exp(np.bincount(self.group, np.log(self.size)) / count)

    def columns(self) -> torch.Tensor:
        """(N, :data:`FACTS` + :data:`ASPECTS`) scalar inputs of the network."""
        size = self.sizes[self.group]
        columns = [np.log(size / _SIZE), np.log(self.size / size), 2 * self.plate - 1, self.disc,
                   self.known, self.known, self.views / 4 - 1, self.views > 0]
        for part, unit in ((self.perspective, 0.4), (self.coefficient, 0.5), (self.nodes, 8.0)):
            finite = np.isfinite(part)
            columns += [finite, np.where(finite, part, unit) / unit - 1]
        # What a regression on the drape coefficient needs.
        share = columns[-3]
        columns += [share**2, share**3, share * columns[2], share * self.disc, columns[2] ** 2]
        aspect = np.log(self.aspect)
        columns += [aspect, aspect**2]
        return torch.from_numpy(np.column_stack(columns).astype(np.float32))


FACTS, ASPECTS = 19, 2
"""Numbers of scalar inputs: of every network, and, after them, of one that reads rectangles."""
_WARP = 5  # column: 1 if azimuth 0 is along the warp, -1 along the weft, 0 not known
_ODD = (_WARP, FACTS)  # columns that a quarter turn gives the opposite sign: that, and the aspect's


@dataclass(frozen=True)
class Batch:
    """Inputs of the network for N captures in M sets."""

    distance: MapTensor  # in sizes of the specimen
    weight: MapTensor  # logarithm of 1 + weight
    outline: torch.Tensor  # (N, AZIMUTHS), in half sizes of the specimen; 0 where not seen
    face: torch.Tensor  # (N,) 1 or -1
    facts: torch.Tensor  # (N, FACTS + ASPECTS)
    group: torch.Tensor  # (N,)
    targets: torch.Tensor | None = None  # (M, TARGETS) standardised; None in inference

    @classmethod
    def of(cls, distance: np.ndarray, weight: np.ndarray, outline: np.ndarray, facts: Facts,
           targets: torch.Tensor | None = None) -> "Batch":
        """Batch of N stored maps (:func:`drapenet.views.radial_map.compressed`) and (N, AZIMUTHS)
        outlines in half sizes (m/m), NaN where not seen."""
        return cls(torch.from_numpy(distance).float(), torch.from_numpy(weight) * WEIGHT_UNIT,
                   torch.from_numpy(np.nan_to_num(outline).astype(np.float32)),
                   torch.from_numpy(facts.face.astype(np.float32)), facts.columns(),
                   torch.from_numpy(facts.group), targets)

    def turned(self, symmetry: Symmetry) -> "Batch":
        """The batch with ``symmetry`` applied to its captures, not to its targets."""
        facts = self.facts.clone()
        for column in _ODD:
            facts[symmetry.exchanged, column] *= -1
        return replace(self, facts=facts, **{name: symmetry.of_rows(getattr(self, name))
                                             for name in ("distance", "weight", "outline")})

    def through(self, network: torch.nn.Module) -> Mixture:
        """The network's posterior, on its device."""
        device = next(network.parameters()).device
        parts = (self.distance, self.weight, self.outline, self.face, self.facts, self.group)
        return network(*(part.to(device) for part in parts))


def circular(inputs: int, outputs: int, stride: int = 1, width: int = 3) -> torch.nn.Conv1d:
    """Convolution around the axis of rows (N, C, azimuths)."""
    return torch.nn.Conv1d(inputs, outputs, width, stride=stride, padding=width // 2, bias=False,
                           padding_mode="circular")


def norm(features: int) -> torch.nn.GroupNorm:
    """Normalisation of each capture by itself: batches mix depth, outlines and numbers."""
    return torch.nn.GroupNorm(min(8, features), features)


class BasicBlock(torch.nn.Module):
    """Residual block of ResNet-18 (He et al. 2016, section 4.1)."""

    def __init__(self, inputs: int, outputs: int, stride: int) -> None:
        super().__init__()
        self.conv1, self.bn1 = circular(inputs, outputs, stride), norm(outputs)
        self.conv2, self.bn2 = circular(outputs, outputs), norm(outputs)
        self.downsample: torch.nn.Module = torch.nn.Identity()
        if stride != 1 or inputs != outputs:
            self.downsample = torch.nn.Sequential(
                torch.nn.Conv1d(inputs, outputs, 1, stride=stride, bias=False),
                norm(outputs))

    def forward(self, rows: torch.Tensor) -> torch.Tensor:
        residual = self.bn2(self.conv2(self.bn1(self.conv1(rows)).relu()))
        return (residual + self.downsample(rows)).relu()


class DrapeNet(torch.nn.Module):
    """Network from sets of captures to a mixture of ``components`` Gaussians.

    ``width``: features of the first stage, 64 in ResNet-18; ``distance``, ``spread``: mean and
    standard deviation of the training distances; ``rectangles``: whether it reads the specimens'
    aspect, as networks do that were trained on rectangles.
    """

    def __init__(
        self, *, width: int, components: int, dropout: float, distance: float, spread: float,
        rectangles: bool = False,
    ) -> None:
        super().__init__()
        self.facts = FACTS + ASPECTS * rectangles
        self.distance, self.spread = distance, spread
        self.bfloat16 = False  # whether convolutions of a training step are in bfloat16
        widths = [width, width, 2 * width, 4 * width, 8 * width]
        self.stem = torch.nn.Sequential(
            circular(CHANNELS, width, stride=2, width=7), norm(width),
            torch.nn.ReLU())
        self.stages = torch.nn.Sequential(*(
            torch.nn.Sequential(BasicBlock(before, after, stride=2 if k else 1),
                                BasicBlock(after, after, stride=1))
            for k, (before, after) in enumerate(pairwise(widths))))
        self.components = components
        features = POOLED * widths[-1] + self.facts
        self.embed = torch.nn.Sequential(
            torch.nn.Dropout(dropout), torch.nn.Linear(features, _EMBEDDING), torch.nn.ReLU(),
            torch.nn.Linear(_EMBEDDING, 2 * _EMBEDDING))
        self.curl = torch.nn.Linear(_EMBEDDING, 2 * 32)
        self.direct = torch.nn.Linear(self.facts, TARGETS)  # to the means of the posterior
        self.head = torch.nn.Sequential(
            torch.nn.Dropout(dropout), torch.nn.Linear(2 * _EMBEDDING + 32 + 1, _EMBEDDING),
            torch.nn.ReLU(), torch.nn.Dropout(dropout),
            torch.nn.Linear(_EMBEDDING, outputs_of(components=components, targets=TARGETS)))

    def forward(
        self, distance: MapTensor, weight: MapTensor, outline: torch.Tensor, face: torch.Tensor,
        facts: torch.Tensor, group: torch.Tensor,
    ) -> Mixture:
        """The posterior of a :class:`Batch`, with outlines (N, AZIMUTHS); lengths in sizes (m/m).
        """
        facts = facts[:, : self.facts]
        features = self.captures(distance, weight, outline, facts)
        value, gate = self.embed(features).chunk(2, dim=1)
        signed, trust = self.curl(value.relu()).chunk(2, dim=1)
        sets = int(group.max()) + 1
        mean, weight = _average(value, softplus(gate), group, sets)
        # Turned over, a fabric's natural curvature has the opposite sign.
        curl, _ = _average(face[:, None] * signed, softplus(trust), group, sets)
        count = torch.bincount(group, minlength=sets).to(mean).log2()[:, None]
        outputs = self.head(torch.cat([mean, weight.log(), curl, count], dim=1))
        mixture = Mixture.of_outputs(outputs, components=self.components, targets=TARGETS)
        known, _ = _average(facts, torch.ones_like(facts), group, sets)
        return replace(mixture, means=mixture.means + self.direct(known)[:, None])

    def captures(
        self, distance: MapTensor, weight: MapTensor, outline: torch.Tensor, facts: torch.Tensor,
    ) -> torch.Tensor:
        """(N, F) features of each capture; arguments as in :class:`Batch`."""
        azimuth = (torch.arange(AZIMUTHS) + 0.5) * (2 * torch.pi / AZIMUTHS)
        place = torch.stack([torch.cos(2 * azimuth), torch.sin(2 * azimuth),
                             torch.cos(4 * azimuth)]).to(distance)
        seen = (outline > 0).float()
        rows = torch.stack([(outline - 0.75) / 0.15 * seen, seen], dim=1)
        rows = torch.cat([rows, place.expand(len(outline), *place.shape)], dim=1)
        maps = torch.cat([(distance - self.distance) / self.spread * (distance > 0).float(),
                          weight.clamp(max=4.0) - 1.0], dim=2).transpose(1, 2)
        with torch.autocast(facts.device.type, torch.bfloat16,
                            enabled=self.bfloat16 and self.training):
            features = self.stages(self.stem(torch.cat([maps, rows], dim=1)))
        return torch.cat([pooled(features.float()), facts], dim=1)


def pooled(features: torch.Tensor) -> torch.Tensor:
    """(N, POOLED C) means around the axis, plain and by waves, of features (N, C, azimuths)."""
    angle = (torch.arange(features.shape[2]) + 0.5) * (2 * torch.pi / features.shape[2])
    waves = [torch.ones_like(angle)]
    for harmonic in _HARMONICS:
        waves += [torch.cos(harmonic * angle), torch.sin(harmonic * angle)]
    return (features @ torch.stack(waves, dim=1).to(features) / features.shape[2]).flatten(1)


def _average(
    values: torch.Tensor, weights: torch.Tensor, group: torch.Tensor, sets: int
) -> tuple[torch.Tensor, torch.Tensor]:
    """Weighted means and means of the weights (M, F) of values and weights (N, F) over sets."""
    total = values.new_zeros(sets, values.shape[1]).index_add(0, group, weights) + 1e-6
    mean = values.new_zeros(sets, values.shape[1]).index_add(0, group, weights * values) / total
    return mean, total / torch.bincount(group, minlength=sets)[:, None]
