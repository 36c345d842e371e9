"""The networks: from sets of captures, read as maps or as pictures, to the fabric's posterior.

Each capture of a set is read alone, from its map, its outline, or its drape coefficient, or from
its depth views; features of the captures are averaged with weights that the network gives them
(after Zaheer et al. 2017, Deep Sets), and the average, the mean of the weights and the number of
captures give one posterior of the fabric. Beside it stands the distribution of a shape given cloth
and specimen (:mod:`drapenet.network.expected`).
"""

import math
from itertools import pairwise
from typing import Any, ClassVar

import torch
from torch.nn.functional import softplus

from drapenet.network.expected import SHAPE
from drapenet.network.inputs import CIRCUMSTANCES, DISC, FACTS, KNOWN, TESTER, Batch, columns_of
from drapenet.network.mixture import Mixture, factor_of, outputs_of
from drapenet.network.targets import CURL, TARGETS
from drapenet.views.directions import AZIMUTHS, ELEVATIONS
from drapenet.views.pictures import PICTURES

_COMPONENTS, _HIDDEN = 4, 64  # of the distribution of shapes
CHANNELS = 2 * ELEVATIONS + 6
"""Distances and weights of a column, outline, whether the outline is seen, its error, cosine and
sine of twice and cosine of four times the azimuth."""
_HARMONICS = (2, 4)  # of the azimuth, for pooling features beside their mean
POOLED = 1 + 2 * len(_HARMONICS)  # values of a feature
_EMBEDDING = 256  # features of a capture
_BACKGROUND = 3.0  # standardised depth where a picture shows no cloth: far behind it


class Expected(torch.nn.Module):
    """Mixture of normal distributions, each with independent entries, of a shape given the
    standardised targets of its cloth and ``facts`` numbers of the capture."""

    def __init__(self, facts: int) -> None:
        super().__init__()
        self.layers = torch.nn.Sequential(
            torch.nn.Linear(TARGETS + facts, _HIDDEN), torch.nn.ReLU(),
            torch.nn.Linear(_HIDDEN, _HIDDEN), torch.nn.ReLU(),
            torch.nn.Linear(_HIDDEN, _COMPONENTS * (1 + 2 * SHAPE)))

    def forward(self, targets: torch.Tensor, facts: torch.Tensor, face: torch.Tensor
                ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Logarithms of the components' weights (..., K), means and logarithms of deviations
        (..., K, SHAPE) for targets (..., TARGETS) of the marked face, captures' facts and faces."""
        turned = targets.clone()
        turned[..., CURL] = targets[..., CURL] * face[..., None]
        out = self.layers(torch.cat([turned, facts], dim=-1))
        out = out.view(*out.shape[:-1], _COMPONENTS, 1 + 2 * SHAPE)
        return (out[..., 0].log_softmax(dim=-1), out[..., 1 : 1 + SHAPE],
                out[..., 1 + SHAPE :].clamp(-5.0, 3.0))

    def log_density(self, shape: torch.Tensor, targets: torch.Tensor, facts: torch.Tensor,
                    face: torch.Tensor) -> torch.Tensor:
        """(...) log density of the known numbers of shapes (..., SHAPE)."""
        weights, means, deviations = self(targets, facts, face)
        known = shape.isfinite()[..., None, :]
        gap = (shape.nan_to_num()[..., None, :] - means) / deviations.exp()
        each = (-gap.square() / 2 - deviations - math.log(2 * math.pi) / 2) * known
        return (weights + each.sum(dim=-1)).logsumexp(dim=-1)


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
    """From sets of captures to the posterior of their fabric; a subclass reads captures, by the
    arrays of a :class:`drapenet.network.inputs.Batch` that :attr:`reads` names beside those of all.

    ``output``: a mixture of ``components`` Gaussians ("posterior"), or means ("regression");
    ``distance``, ``spread``: mean and standard deviation of the training distances or depths;
    ``rectangles``: whether it reads the specimens' aspect, as networks do that were trained on
    rectangles; ``expected``: whether it knows how captures of a cloth look.
    """

    reads: ClassVar[tuple[str, ...]] = ()

    def __init__(
        self, *, components: int, dropout: float, distance: float, spread: float,
        rectangles: bool = False, output: str = "posterior", expected: bool = False,
    ) -> None:
        super().__init__()
        self.output, self.components, self.dropout = output, components, dropout
        self.distance, self.spread = distance, spread
        self.rectangles = rectangles
        self.expected = Expected(CIRCUMSTANCES) if expected else None
        self.in_bfloat16 = False  # whether convolutions of a training step are in bfloat16

    def add_layers(self, features: int, facts: int) -> None:
        """Layers from the ``features`` of each capture, the first ``facts`` columns and those that
        not all networks read to the posterior."""
        self.columns = columns_of(facts, self.rectangles)
        regression = self.output == "regression"
        dropout = self.dropout
        facts = len(self.columns)
        self.embed = torch.nn.Sequential(
            torch.nn.Dropout(dropout), torch.nn.Linear(features + facts, _EMBEDDING),
            torch.nn.ReLU(), torch.nn.Linear(_EMBEDDING, 2 * _EMBEDDING))
        self.curl = torch.nn.Linear(_EMBEDDING, 2 * 32)
        self.direct = torch.nn.Linear(facts, TARGETS)  # to the means of the posterior
        self.head = torch.nn.Sequential(
            torch.nn.Dropout(dropout), torch.nn.Linear(2 * _EMBEDDING + 32 + 1, _EMBEDDING),
            torch.nn.ReLU(), torch.nn.Dropout(dropout), torch.nn.Linear(
                _EMBEDDING, TARGETS if regression else
                outputs_of(components=self.components, targets=TARGETS)))
        if regression:
            self.register_buffer("factor", torch.eye(TARGETS))
        else:
            self.factor = None

    def separate_parts(self) -> list[list[torch.nn.Parameter]]:
        """Parameters that have nothing to do with each other, whose gradients are clipped apart."""
        expected = list(self.expected.parameters()) if self.expected else []
        others = {id(one) for one in expected}
        return [expected, [one for one in self.parameters() if id(one) not in others]]

    def hidden_weights(self) -> list[torch.nn.Parameter]:
        """Weights from features to features of the posterior's network, (outputs, inputs, ...)."""
        ends = {id(layer.weight) for layer in (self.direct, self.head[-1])}
        return [one for one in self.separate_parts()[1] if one.ndim > 1 and id(one) not in ends]

    def tensors(self, batch: Batch, *names: str) -> list[torch.Tensor]:
        """Arrays (N, ...) of a batch on the network's device."""
        device = next(self.parameters()).device
        return [torch.from_numpy(getattr(batch, name)).to(device) for name in names]

    def log_density_of_shapes(self, batch: Batch) -> torch.Tensor:
        """(N,) of the captures' shapes, of the true cloth; 0 of a network that expects none."""
        shape, facts, face, group = self.tensors(batch, "shape", "circumstances", "face", "group")
        if self.expected is None or batch.targets is None:
            return torch.zeros(len(group), device=facts.device)
        targets, = self.tensors(batch, "targets")
        return self.expected.log_density(shape, targets[group], facts, face)

    def answer(self, batch: Batch) -> Mixture:
        """The posterior of a batch, on the network's device."""
        return Mixture(*self(*self.tensors(batch, "face", "facts", "members", *self.reads)))

    def posterior(
        self, captures: torch.Tensor, face: torch.Tensor, facts: torch.Tensor, members: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Parts of the :class:`Mixture` of features (N, F) of captures. That of a regression has
        unit variances in training, so that its likelihood is the mean square error, and then those
        of :meth:`calibrated`."""
        columns = facts[:, self.columns]
        value, gate = self.embed(torch.cat([captures, columns], dim=1)).chunk(2, dim=1)
        signed, trust = self.curl(value.relu()).chunk(2, dim=1)
        mean, weight = _average(value, softplus(gate), members)
        # Turned over, a fabric's natural curvature has the opposite sign.
        curl, _ = _average(face[:, None] * signed, softplus(trust), members)
        count = members.sum(dim=1, keepdim=True).log2()
        outputs = self.head(torch.cat([mean, weight.log(), curl, count], dim=1))
        if self.factor is None:
            mixture = Mixture.of_outputs(outputs, components=self.components, targets=TARGETS)
        else:
            unit = torch.eye(TARGETS, device=outputs.device)
            mixture = Mixture.around(outputs, unit if self.training else self.factor)
        known, _ = _average(columns, torch.ones_like(columns), members)
        return mixture.logits, mixture.means + self.direct(known)[:, None], mixture.factors

    def calibrated(self, answer: Mixture, targets: torch.Tensor) -> Mixture:
        """The ``answer`` for ``targets`` (N, TARGETS) of validation; a regression states the
        covariance of its residuals from now on, a posterior its own."""
        if self.factor is None:
            return answer
        self.factor.copy_(factor_of(targets - answer.mean))
        return Mixture.around(answer.mean, self.factor.cpu())


class DrapeNet(Network):
    """Network of maps and outlines, a ResNet-18 over azimuth.

    A column of a map, the cloth at one azimuth, is a feature vector; convolutions run around the
    axis. ``width``: features of the first stage, 64 in ResNet-18.
    """

    reads = ("distance", "weight", "outline", "error")

    def __init__(self, *, width: int, **options: Any) -> None:
        super().__init__(**options)
        widths = [width, width, 2 * width, 4 * width, 8 * width]
        self.stem = torch.nn.Sequential(
            circular(CHANNELS, width, stride=2, width=7), norm(width),
            torch.nn.ReLU())
        self.stages = torch.nn.Sequential(*(
            torch.nn.Sequential(BasicBlock(before, after, stride=2 if k else 1),
                                BasicBlock(after, after, stride=1))
            for k, (before, after) in enumerate(pairwise(widths))))
        self.add_layers(POOLED * widths[-1], FACTS)

    def forward(
        self, face: torch.Tensor, facts: torch.Tensor, members: torch.Tensor,
        distance: torch.Tensor, weight: torch.Tensor, outline: torch.Tensor, error: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Parts of a :class:`Mixture`, of a batch's arrays (N, ...), whose units it states: sizes
        of the specimen, m/m."""
        azimuth = (torch.arange(AZIMUTHS) + 0.5) * (2 * torch.pi / AZIMUTHS)
        place = torch.stack([torch.cos(2 * azimuth), torch.sin(2 * azimuth),
                             torch.cos(4 * azimuth)]).to(distance)
        seen = (outline > 0).float()
        rows = torch.stack([(outline - 0.75) / 0.15 * seen, seen, error], dim=1)
        rows = torch.cat([rows, place.expand(outline.shape[0], *place.shape)], dim=1)
        maps = torch.cat([(distance - self.distance) / self.spread * (distance > 0).float(),
                          weight.clamp(max=4.0) - 1.0], dim=2).transpose(1, 2)
        with torch.autocast(distance.device.type, torch.bfloat16,
                            enabled=self.in_bfloat16 and self.training):
            features = self.stages(self.stem(torch.cat([maps, rows], dim=1)))
        return self.posterior(pooled(features.float()), face, facts, members)


class ViewNet(Network):
    """Network of four stacked depth views, the one of Feng et al. 2022.

    ``backbone``: a network of torchvision, whose classes are ``width`` features.
    """

    reads = ("pictures", "angle")

    def __init__(self, *, backbone: str, width: int, **options: Any) -> None:
        from torchvision.models import get_model  # takes a second

        super().__init__(**options)
        self.backbone = get_model(backbone, weights=None, num_classes=width)
        name, first = next((name, part) for name, part in self.backbone.named_modules()
                           if isinstance(part, torch.nn.Conv2d))
        shape: dict[str, Any] = {key: getattr(first, key)
                                 for key in ("kernel_size", "stride", "padding")}
        self.backbone.set_submodule(name, torch.nn.Conv2d(
            PICTURES, first.out_channels, bias=first.bias is not None, **shape))
        self.add_layers(width + 1, TESTER)  # what the drape is like is to be read of the pictures

    def forward(
        self, face: torch.Tensor, facts: torch.Tensor, members: torch.Tensor,
        pictures: torch.Tensor, angle: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Parts of a :class:`Mixture`, of a batch's arrays (N, ...). The angle of azimuth 0, rad,
        has no meaning for a disc whose warp is not stated."""
        depth = (pictures - self.distance) / self.spread
        depth = torch.where(depth.isnan(), _BACKGROUND, depth)
        depth = depth.contiguous(memory_format=torch.channels_last)  # a third faster on a CPU
        with torch.autocast(depth.device.type, torch.bfloat16,
                            enabled=self.in_bfloat16 and self.training):
            features = self.backbone(depth)
        sure = torch.maximum(facts[:, KNOWN], 1 - facts[:, DISC])
        features = torch.cat([features.float(), (angle * sure)[:, None]], dim=1)
        return self.posterior(features, face, facts, members)


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
    values: torch.Tensor, weights: torch.Tensor, members: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor]:
    """Weighted means and means of the weights (M, F) of values and weights (N, F) over sets, whose
    ``members`` (M, N) are 1."""
    total = members @ weights + 1e-6
    return members @ (weights * values) / total, total / members.sum(dim=1, keepdim=True)
