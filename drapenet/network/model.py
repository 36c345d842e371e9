"""The networks and their input: sets of captures, read as maps or as pictures.

Each capture of a set is read alone, from its map, its outline, or its drape coefficient, or from
its depth views; features of the captures are averaged with weights that the network gives them
(after Zaheer et al. 2017, Deep Sets), and the average, the mean of the weights and the number of
captures give one posterior of the fabric.
"""

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Annotated, Any

import numpy as np
import torch
from torch.nn.functional import softplus

from drapenet.network.expected import Expected, shape_of
from drapenet.network.posterior import Mixture, factor_of, outputs_of
from drapenet.network.targets import TARGETS, Symmetry
from drapenet.views.directions import AZIMUTHS, ELEVATIONS
from drapenet.views.pictures import PICTURES
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

    @property
    def share(self) -> np.ndarray:
        """(N,) drape coefficients as a network reads them: a few depth maps of nearly flat cloth
        have a hem far out."""
        return self.coefficient.clip(0.0, _MAX_COEFFICIENT)

    def columns(self) -> torch.Tensor:
        """(N, :data:`FACTS` + :data:`ASPECTS`) scalar inputs of the network."""
        size = self.sizes[self.group]
        columns = [np.log(size / _SIZE), np.log(self.size / size), 2 * self.plate - 1, self.disc,
                   self.known, self.known, self.views / 4 - 1, self.views > 0]
        for part, unit in ((self.perspective, 0.4), (self.share, 0.5), (self.nodes, 8.0)):
            finite = np.isfinite(part)
            columns += [finite, np.where(finite, part, unit) / unit - 1]
        # What a regression on the drape coefficient needs.
        share = columns[-3]
        columns += [share**2, share**3, share * columns[2], share * self.disc, columns[2] ** 2]
        aspect = np.log(self.aspect)
        columns += [aspect, aspect**2]
        return torch.from_numpy(np.column_stack(columns).astype(np.float32))


_MAX_COEFFICIENT = 1.05
FACTS, ASPECTS = 19, 2
"""Numbers of scalar inputs: of every network, and, after them, of one that reads rectangles."""
_WARP = 5  # column: 1 if azimuth 0 is along the warp, -1 along the weft, 0 not known
_ODD = (_WARP, FACTS)  # columns that a quarter turn gives the opposite sign: that, and the aspect's
_DISC, _KNOWN = 3, 4  # columns
_TESTER = 6  # the first columns, which state specimen, tester and warp, and nothing of the drape
_CIRCUMSTANCES = 10  # the first columns: those, number of views and perspective
_BACKGROUND = 3.0  # standardised depth where a picture shows no cloth: far behind it


@dataclass(frozen=True)
class Batch:
    """Inputs of the network for N captures in M sets."""

    distance: MapTensor  # in sizes of the specimen
    weight: MapTensor  # logarithm of 1 + weight
    outline: torch.Tensor  # (N, AZIMUTHS), in half sizes of the specimen; 0 where not seen
    face: torch.Tensor  # (N,) 1 or -1
    facts: torch.Tensor  # (N, FACTS + ASPECTS)
    group: torch.Tensor  # (N,)
    pictures: torch.Tensor  # (N, PICTURES or 0, SIDE, SIDE) in sizes, NaN where there is no cloth
    angle: torch.Tensor  # (N,) of azimuth 0 in the first picture, rad
    shape: torch.Tensor  # (N, SHAPE), see :mod:`drapenet.network.expected`
    targets: torch.Tensor | None = None  # (M, TARGETS) standardised; None in inference

    @classmethod
    def of(cls, distance: np.ndarray, weight: np.ndarray, outline: np.ndarray, facts: Facts,
           pictures: np.ndarray, angle: np.ndarray, targets: torch.Tensor | None = None) -> "Batch":
        """Batch of N stored maps (:func:`drapenet.views.radial_map.compressed`), (N, AZIMUTHS)
        outlines in half sizes (m/m), NaN where not seen, pictures and their angles, rad."""
        # Of a single view, much of the hem is guessed, and with it all but the coefficient.
        hem = np.where((facts.views == 1)[:, None], np.nan, outline)
        return cls(torch.from_numpy(distance).float(), torch.from_numpy(weight) * WEIGHT_UNIT,
                   torch.from_numpy(np.nan_to_num(outline).astype(np.float32)),
                   torch.from_numpy(facts.face.astype(np.float32)), facts.columns(),
                   torch.from_numpy(facts.group), torch.from_numpy(pictures).float(),
                   torch.from_numpy(angle.astype(np.float32)), torch.from_numpy(
                       shape_of(hem, facts.share, facts.nodes).astype(np.float32)), targets)

    def turned(self, symmetry: Symmetry) -> "Batch":
        """The batch with ``symmetry`` applied to its captures, not to its targets."""
        facts = self.facts.clone()
        for column in _ODD:
            facts[symmetry.exchanged, column] *= -1
        return replace(self, facts=facts, pictures=symmetry.of_pictures(self.pictures),
                       angle=symmetry.of_angles(self.angle),
                       **{name: symmetry.of_rows(getattr(self, name))
                          for name in ("distance", "weight", "outline")})

    def on(self, device: torch.device) -> "Batch":
        """The batch on a ``device``."""
        return replace(self, **{name: part.to(device) for name, part in vars(self).items()
                                if part is not None})

    def through(self, network: torch.nn.Module) -> Mixture:
        """The network's posterior, on its device."""
        return network(self.on(next(network.parameters()).device))


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


class Network(torch.nn.Module):
    """From sets of captures to the posterior of their fabric; a subclass reads a capture.

    ``distance``, ``spread``: mean and standard deviation of the training distances or depths;
    ``rectangles``: whether it reads the specimens' aspect, as networks do that were trained on
    rectangles; ``expected``: whether it knows how captures of a cloth look.
    """

    def __init__(
        self, *, distance: float, spread: float, rectangles: bool, expected: bool
    ) -> None:
        super().__init__()
        self.distance, self.spread, self.rectangles = distance, spread, rectangles
        self.expected = Expected(_CIRCUMSTANCES + ASPECTS) if expected else None
        self.in_bfloat16 = False  # whether convolutions of a training step are in bfloat16

    def add_layers(self, features: int, *, facts: int, output: str, components: int,
                   dropout: float) -> None:
        """Layers from the ``features`` of each capture and ``facts`` columns to the posterior: a
        mixture of ``components`` Gaussians, or means ("regression")."""
        self.facts, self.components = facts, components
        self.embed = torch.nn.Sequential(
            torch.nn.Dropout(dropout), torch.nn.Linear(features + facts, _EMBEDDING),
            torch.nn.ReLU(), torch.nn.Linear(_EMBEDDING, 2 * _EMBEDDING))
        self.curl = torch.nn.Linear(_EMBEDDING, 2 * 32)
        self.direct = torch.nn.Linear(facts, TARGETS)  # to the means of the posterior
        self.head = torch.nn.Sequential(
            torch.nn.Dropout(dropout), torch.nn.Linear(2 * _EMBEDDING + 32 + 1, _EMBEDDING),
            torch.nn.ReLU(), torch.nn.Dropout(dropout), torch.nn.Linear(
                _EMBEDDING, TARGETS if output == "regression" else
                outputs_of(components=components, targets=TARGETS)))
        if output == "regression":
            self.register_buffer("factor", torch.eye(TARGETS))
        else:
            self.factor = None

    def columns(self, facts: torch.Tensor) -> torch.Tensor:
        """(N, F) columns that the network reads of a batch's ``facts`` (N, FACTS + ASPECTS)."""
        return facts[:, : self.facts]

    def captures(self, batch: Batch) -> torch.Tensor:
        """(N, F) features of each capture."""
        raise NotImplementedError

    def separate_parts(self) -> list[list[torch.nn.Parameter]]:
        """Parameters that have nothing to do with each other, whose gradients are clipped apart."""
        expected = list(self.expected.parameters()) if self.expected else []
        others = {id(one) for one in expected}
        return [expected, [one for one in self.parameters() if id(one) not in others]]

    def hidden_weights(self) -> list[torch.nn.Parameter]:
        """Weights from features to features of the posterior's network, (outputs, inputs, ...)."""
        ends = {id(layer.weight) for layer in (self.direct, self.head[-1])}
        return [one for one in self.separate_parts()[1] if one.ndim > 1 and id(one) not in ends]

    def log_density_of_shapes(self, batch: Batch) -> torch.Tensor:
        """(N,) of the captures' shapes, of the true cloth; 0 of a network that expects none."""
        if self.expected is None or batch.targets is None:
            return torch.zeros(len(batch.group), device=batch.facts.device)
        return self.expected.log_density(batch.shape, batch.targets[batch.group],
                                         circumstances(batch), batch.face)

    def forward(self, batch: Batch) -> Mixture:
        """The posterior of a batch. That of a regression has unit variances in training, so that
        its likelihood is the mean square error, and then those of :meth:`calibrated`."""
        facts, group = self.columns(batch.facts), batch.group
        features = torch.cat([self.captures(batch), facts], dim=1)
        value, gate = self.embed(features).chunk(2, dim=1)
        signed, trust = self.curl(value.relu()).chunk(2, dim=1)
        sets = int(group.max()) + 1
        mean, weight = _average(value, softplus(gate), group, sets)
        # Turned over, a fabric's natural curvature has the opposite sign.
        curl, _ = _average(batch.face[:, None] * signed, softplus(trust), group, sets)
        count = torch.bincount(group, minlength=sets).to(mean).log2()[:, None]
        outputs = self.head(torch.cat([mean, weight.log(), curl, count], dim=1))
        if self.factor is None:
            mixture = Mixture.of_outputs(outputs, components=self.components, targets=TARGETS)
        else:
            unit = torch.eye(TARGETS, device=outputs.device)
            mixture = Mixture.around(outputs, unit if self.training else self.factor)
        known, _ = _average(facts, torch.ones_like(facts), group, sets)
        return replace(mixture, means=mixture.means + self.direct(known)[:, None])

    def calibrated(self, answer: Mixture, targets: torch.Tensor) -> Mixture:
        """The ``answer`` for ``targets`` (N, TARGETS) of validation; a regression states the
        covariance of its residuals from now on, a posterior its own."""
        if self.factor is None:
            return answer
        self.factor.copy_(factor_of(targets - answer.mean))
        return Mixture.around(answer.mean, self.factor.cpu())


class DrapeNet(Network):
    """Network of maps, a ResNet-18 over azimuth.

    A column of a map, the cloth at one azimuth, is a feature vector; convolutions run around the
    axis. ``width``: features of the first stage, 64 in ResNet-18.
    """

    def __init__(
        self, *, width: int, components: int, dropout: float, distance: float, spread: float,
        rectangles: bool = False, output: str = "posterior", expected: bool = False,
    ) -> None:
        super().__init__(distance=distance, spread=spread, rectangles=rectangles,
                         expected=expected)
        widths = [width, width, 2 * width, 4 * width, 8 * width]
        self.stem = torch.nn.Sequential(
            circular(CHANNELS, width, stride=2, width=7), norm(width),
            torch.nn.ReLU())
        self.stages = torch.nn.Sequential(*(
            torch.nn.Sequential(BasicBlock(before, after, stride=2 if k else 1),
                                BasicBlock(after, after, stride=1))
            for k, (before, after) in enumerate(pairwise(widths))))
        self.add_layers(POOLED * widths[-1], facts=FACTS + ASPECTS * rectangles, output=output,
                        components=components, dropout=dropout)

    def captures(self, batch: Batch) -> torch.Tensor:
        """(N, F) features of maps and outlines."""
        distance, outline = batch.distance, batch.outline
        azimuth = (torch.arange(AZIMUTHS) + 0.5) * (2 * torch.pi / AZIMUTHS)
        place = torch.stack([torch.cos(2 * azimuth), torch.sin(2 * azimuth),
                             torch.cos(4 * azimuth)]).to(distance)
        seen = (outline > 0).float()
        rows = torch.stack([(outline - 0.75) / 0.15 * seen, seen], dim=1)
        rows = torch.cat([rows, place.expand(len(outline), *place.shape)], dim=1)
        maps = torch.cat([(distance - self.distance) / self.spread * (distance > 0).float(),
                          batch.weight.clamp(max=4.0) - 1.0], dim=2).transpose(1, 2)
        with torch.autocast(distance.device.type, torch.bfloat16,
                            enabled=self.in_bfloat16 and self.training):
            features = self.stages(self.stem(torch.cat([maps, rows], dim=1)))
        return pooled(features.float())


class ViewNet(Network):
    """Network of four stacked depth views, the one of Feng et al. 2022.

    ``backbone``: a network of torchvision, whose classes are ``width`` features.
    """

    def __init__(
        self, *, backbone: str, width: int, components: int, dropout: float, distance: float,
        spread: float, rectangles: bool = False, output: str = "posterior",
        expected: bool = False,
    ) -> None:
        from torchvision.models import get_model  # takes a second

        super().__init__(distance=distance, spread=spread, rectangles=rectangles,
                         expected=expected)
        self.backbone = get_model(backbone, weights=None, num_classes=width)
        name, first = next((name, part) for name, part in self.backbone.named_modules()
                           if isinstance(part, torch.nn.Conv2d))
        shape: dict[str, Any] = {key: getattr(first, key)
                                 for key in ("kernel_size", "stride", "padding")}
        self.backbone.set_submodule(name, torch.nn.Conv2d(
            PICTURES, first.out_channels, bias=first.bias is not None, **shape))
        self.add_layers(width + 1, facts=_TESTER + ASPECTS * rectangles, output=output,
                        components=components, dropout=dropout)

    def columns(self, facts: torch.Tensor) -> torch.Tensor:
        """(N, F) columns of tester, warp and aspect, of (N, FACTS + ASPECTS): what the drape is
        like is to be read of the pictures."""
        return torch.cat([facts[:, :_TESTER], facts[:, FACTS:]], dim=1)[:, : self.facts]

    def captures(self, batch: Batch) -> torch.Tensor:
        """(N, F) features of pictures, the last the angle of azimuth 0, which has no meaning for a
        disc whose warp is not stated."""
        depth = (batch.pictures - self.distance) / self.spread
        depth = torch.where(depth.isnan(), _BACKGROUND, depth)
        with torch.autocast(depth.device.type, torch.bfloat16,
                            enabled=self.in_bfloat16 and self.training):
            features = self.backbone(depth)
        sure = torch.maximum(batch.facts[:, _KNOWN], 1 - batch.facts[:, _DISC])
        return torch.cat([features.float(), (batch.angle * sure)[:, None]], dim=1)


def circumstances(batch: Batch) -> torch.Tensor:
    """(N, F) columns of the facts that say nothing of the drape, F = _CIRCUMSTANCES + ASPECTS."""
    return torch.cat([batch.facts[:, :_CIRCUMSTANCES], batch.facts[:, FACTS:]], dim=1)


def make_network(*, backbone: str | None = None, **options: Any) -> Network:
    """The network of a checkpoint's description (``model``), with random weights."""
    return ViewNet(backbone=backbone, **options) if backbone else DrapeNet(**options)


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
