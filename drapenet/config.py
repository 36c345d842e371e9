"""Settings of a training run and what follows from them alone."""

import math
from dataclasses import asdict, dataclass, field

from common.errors import InputError
from drapenet.preprocess import InputFormat

VIEW_SOURCES = ("stored", "cached", "fresh")


@dataclass
class ModelConfig:
    """Backbone and its input, see :mod:`drapenet.model` and :mod:`drapenet.preprocess`."""

    backbone: str = "resnet18"
    input_width: int = 120
    input_height: int = 90
    crop_width: int = 0
    crop_height: int = 0

    @property
    def form(self) -> InputFormat:
        """The network's input."""
        return InputFormat(width=self.input_width, height=self.input_height,
                           crop_width=self.crop_width, crop_height=self.crop_height)


@dataclass
class OptimConfig:
    """Adam and its learning rate; the defaults are those of Feng et al. 2022, section 6.1.

    Attributes:
        learning_rate: largest learning rate.
        weight_decay: of Adam, added to the gradient.
        batch_size: drapes a step.
        schedule: ``exponential`` (times ``decay`` each epoch) or ``one_cycle`` (up along a
            cosine during ``warm_up`` of the training, down to nothing over the rest).
        direction_weight: weight of the stiff axis in the loss.
        ratio_weight: weight of the errors of beta/alpha in the loss.
    """

    learning_rate: float = 1e-4
    weight_decay: float = 1e-4
    batch_size: int = 128
    schedule: str = "exponential"
    decay: float = 0.995
    warm_up: float = 0.0
    direction_weight: float = 0.5
    ratio_weight: float = 1.0


@dataclass
class TrainConfig:
    """All settings of a training run; ``configs/train.yaml`` explains them."""

    data: str = "outputs/dataset"
    out: str = "outputs/train"
    initial: str = ""
    seed: int = 0
    epochs: int = 300
    validation_fraction: float = 0.2
    fabrics: int = 0
    drapes_each: int = 0
    views: str = "stored"
    orientations_per_epoch: int = 1
    device: str = "auto"
    workers: int = 2
    threads: int = 0
    half_precision: bool = True
    sensor: dict = field(default_factory=dict)
    model: ModelConfig = field(default_factory=ModelConfig)
    optim: OptimConfig = field(default_factory=OptimConfig)

    def check(self) -> None:
        """Raise InputError for settings that make no sense."""
        if self.epochs < 1 or self.optim.batch_size < 2:
            raise InputError("training needs epochs >= 1 and optim.batch_size >= 2")
        if self.views not in VIEW_SOURCES:
            raise InputError(f"unknown views '{self.views}'; use {', '.join(VIEW_SOURCES)}")
        if not 0 < self.validation_fraction < 1:
            raise InputError("validation_fraction must lie between 0 and 1")
        if self.optim.schedule not in ("exponential", "one_cycle"):
            raise InputError(f"unknown optim.schedule '{self.optim.schedule}'; "
                             "use exponential or one_cycle")
        if not 0 <= self.optim.warm_up < 1:
            raise InputError("optim.warm_up is a part of the training, from 0 to below 1")
        if not self.optim.learning_rate > 0 or not self.optim.weight_decay >= 0:
            raise InputError("optim.learning_rate must be positive, optim.weight_decay not "
                             "negative")
        if not 0 < self.optim.decay <= 1:
            raise InputError("optim.decay must lie above 0 and not above 1")
        if not min(self.optim.direction_weight, self.optim.ratio_weight) >= 0:
            raise InputError("optim.direction_weight and optim.ratio_weight must not be negative")
        if min(self.seed, self.workers, self.threads, self.fabrics, self.drapes_each) < 0:
            raise InputError("seed, workers, threads, fabrics and drapes_each must not be negative")

    def defining(self) -> dict:
        """The settings that a resumed run must share: all but places and machinery."""
        settings = asdict(self)
        for name in ("data", "out", "device", "workers", "threads", "half_precision"):
            del settings[name]
        return settings


def learning_rate(optim: OptimConfig, *, epoch: int, progress: float) -> float:
    """Learning rate in ``epoch``, after the fraction ``progress`` of the whole training."""
    if optim.schedule == "exponential":
        return optim.learning_rate * optim.decay**epoch
    if progress < optim.warm_up:
        return optim.learning_rate * (0.04 + 0.96 * _half_cosine(1 - progress / optim.warm_up))
    return optim.learning_rate * _half_cosine((progress - optim.warm_up) / (1 - optim.warm_up))


def _half_cosine(x: float) -> float:
    """1 at 0, smoothly down to 0 at 1."""
    return (1 + math.cos(math.pi * x)) / 2
