"""Settings of a training run and what follows from them alone."""

import math
from dataclasses import asdict, dataclass, field

from common.errors import InputError


@dataclass
class ModelConfig:
    """See :class:`drapenet.network.MapNet`."""

    width: int = 32
    components: int = 2


@dataclass
class OptimConfig:
    """AdamW, and a learning rate that rises and falls once along cosines.

    Attributes:
        learning_rate: the largest.
        warm_up: share of the training in which it rises.
        weight_decay: of AdamW.
        batch_size: captures a step.
        clip: largest norm of a step's gradient.
    """

    learning_rate: float = 2e-3
    warm_up: float = 0.05
    weight_decay: float = 1e-2
    batch_size: int = 64
    clip: float = 5.0


@dataclass
class TrainConfig:
    """All settings of a training run; ``configs/train.yaml`` explains them."""

    data: str = "outputs/dataset"
    out: str = "outputs/train"
    maps: str = "outputs/maps"
    seed: int = 0
    epochs: int = 10
    captures: int = 5
    neighbours: bool = True
    validation_fraction: float = 0.05
    fabrics: int = 0
    device: str = "auto"
    workers: int = 2
    threads: int = 0
    half_precision: bool = True
    setup: dict = field(default_factory=dict)
    model: ModelConfig = field(default_factory=ModelConfig)
    optim: OptimConfig = field(default_factory=OptimConfig)

    def check(self) -> None:
        """Raise InputError for settings that make no sense."""
        optim = self.optim
        if self.epochs < 1 or self.captures < 1 or optim.batch_size < 2:
            raise InputError("training needs epochs >= 1, captures >= 1, optim.batch_size >= 2")
        if self.model.width < 1 or self.model.components < 1:
            raise InputError("model.width and model.components must be at least 1")
        if not 0 < self.validation_fraction < 1:
            raise InputError("validation_fraction must lie between 0 and 1")
        if not 0 <= optim.warm_up < 1:
            raise InputError("optim.warm_up is a share of the training, from 0 to below 1")
        if not (optim.learning_rate > 0 and optim.weight_decay >= 0 and optim.clip > 0):
            raise InputError("optim.learning_rate and optim.clip must be positive, "
                             "optim.weight_decay not negative")
        if min(self.seed, self.threads, self.fabrics) < 0 or self.workers < 1:
            raise InputError("seed, threads and fabrics must not be negative, workers at least 1")

    def defining(self) -> dict:
        """The settings that a resumed run must share: all but places and machinery."""
        settings = asdict(self)
        for name in ("data", "out", "maps", "device", "workers", "threads", "half_precision"):
            del settings[name]
        return settings


def learning_rate(optim: OptimConfig, progress: float) -> float:
    """Learning rate after the share ``progress`` of the training."""
    if progress < optim.warm_up:
        return optim.learning_rate * (0.04 + 0.96 * _half_cosine(1 - progress / optim.warm_up))
    return optim.learning_rate * _half_cosine((progress - optim.warm_up) / (1 - optim.warm_up))


def _half_cosine(x: float) -> float:
    """1 at 0, smoothly down to 0 at 1."""
    return (1 + math.cos(math.pi * x)) / 2
