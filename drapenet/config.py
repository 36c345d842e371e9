"""Types of the keys of ``configs/``, which explains them and holds their defaults."""

import math
from dataclasses import asdict, dataclass
from typing import Any

from common.errors import InputError

MOST_CORES = 1024


@dataclass
class ModelConfig:
    """See :class:`drapenet.network.MapNet`."""

    width: int
    components: int


@dataclass
class OptimConfig:
    """AdamW, and a learning rate that rises and falls once along cosines."""

    learning_rate: float
    warm_up: float
    weight_decay: float
    batch_size: int
    clip: float


@dataclass
class TrainConfig:
    """``configs/train.yaml``: all settings of a training run."""

    data: str
    out: str
    maps: str
    seed: int
    epochs: int
    captures: int
    neighbours: bool
    validation_fraction: float
    fabrics: int
    device: str
    workers: int
    threads: int
    half_precision: bool
    setup: dict[str, Any]
    model: ModelConfig
    optim: OptimConfig

    def check(self) -> None:
        """Raise InputError for settings that make no sense."""
        optim = self.optim
        for name, value, low, high in (
                ("seed", self.seed, 0, 2**63 - 1), ("threads", self.threads, 0, MOST_CORES),
                ("workers", self.workers, 1, MOST_CORES), ("fabrics", self.fabrics, 0, 10**9),
                ("model.width", self.model.width, 1, 512),
                ("model.components", self.model.components, 1, 32)):
            if not low <= value <= high:
                raise InputError(f"{name}={value} must lie between {low} and {high}")
        for name, value, least in (
                ("epochs", self.epochs, 1), ("captures", self.captures, 1),
                ("optim.batch_size", optim.batch_size, 2),
                ("optim.weight_decay", optim.weight_decay, 0)):
            if not value >= least:
                raise InputError(f"{name}={value} must be at least {least}")
        for name, value in (("optim.learning_rate", optim.learning_rate),
                            ("optim.clip", optim.clip)):
            if not value > 0:
                raise InputError(f"{name}={value} must be positive")
        if not 0 < self.validation_fraction < 1:
            raise InputError(f"validation_fraction={self.validation_fraction} must lie between 0 "
                             "and 1")
        if not 0 <= optim.warm_up < 1:
            raise InputError(f"optim.warm_up={optim.warm_up} must be a share of the training, from "
                             "0 to below 1")

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


@dataclass
class InferConfig:
    """``configs/infer.yaml``. ``capture`` and ``scan`` are one path or a list of them."""

    capture: Any
    captures: str
    scan: Any
    out: str
    checkpoint: str
    refine: dict[str, Any]
    export: str
    workers: int
    drapes: int
    edge_mm: float
    membrane_n_per_m: float
    friction_un: float
    density_g_m2: float
    held: float
    strict: bool


@dataclass
class EvaluateConfig:
    """``configs/evaluate.yaml``."""

    rig: str
    checkpoint: str
    out: str
    fabrics: str
    drapes: int
    captures: int
    seed: int
    workers: int


@dataclass
class ExportConfig:
    """``configs/export.yaml``."""

    estimate: str
    to: str
    out: str
    name: str
    curvature_1_m: float
    mesh: str
    edge_mm: float
