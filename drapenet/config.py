"""Types and ranges of the keys in ``configs/``, where they are documented and have defaults."""

import os
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field

from common.configs import Seed, Workers
from common.types import Metres

FromOne = Annotated[int, Field(ge=1)]
FromZero = Annotated[int, Field(ge=0)]
Positive = Annotated[float, Field(gt=0)]
Backbone = Literal["resnet18", "resnet34", "alexnet", "efficientnet_b0", "vgg16"]
"""Networks of torchvision that read depth views."""
Output = Literal["posterior", "regression"]
Input = Literal["depth", "outline", "numbers"]
"""What is read of a capture: depth views, an outline, or drape coefficient and nodes."""


@dataclass
class ModelConfig:
    """See :class:`drapenet.network.model.Network`."""

    backbone: Backbone | None
    output: Output
    width: Annotated[int, Field(ge=1, le=512)]
    components: Annotated[int, Field(ge=1, le=32)]
    dropout: Annotated[float, Field(ge=0, lt=1)]


@dataclass
class OptimConfig:
    """Muon and AdamW with one cosine cycle of the learning rate, see `training.learning_rate`."""

    learning_rate: Positive
    warm_up: Annotated[float, Field(ge=0, lt=1)]
    weight_decay: Annotated[float, Field(ge=0)]
    batch_size: Annotated[int, Field(ge=2)]
    clip: Positive


@dataclass
class TrainConfig:
    """``configs/train.yaml``: all settings of a training run."""

    data: Any  # a folder or a list of them
    out: str
    maps: str
    start: str
    seed: Seed
    epochs: FromOne
    inputs: Annotated[list[Input], Field(min_length=1)]
    captures: FromOne
    neighbours: bool
    outlines: FromZero
    validation_fraction: Annotated[float, Field(gt=0, lt=1)]
    fabrics: FromOne | None
    tester: str | None
    device: Literal["auto", "cpu", "cuda"]
    workers: Workers
    threads: Annotated[int | None, Field(ge=1, le=1024)]
    bfloat16: bool
    half_precision: bool
    graphs: bool
    setup: dict[str, Any]
    model: ModelConfig
    optim: OptimConfig

    def defining(self) -> dict:
        """Settings that a resumed run must share: all but paths, device and processes."""
        settings = asdict(self)
        for name in ("data", "out", "maps", "start", "device", "workers", "threads",
                     "half_precision", "graphs"):
            del settings[name]
        return settings


@dataclass
class InferConfig:
    """``configs/infer.yaml``. ``capture`` and ``scan`` are one path or a list of them."""

    capture: Any
    captures: str
    scan: Any
    strips: str
    tension: str
    out: str
    checkpoint: str
    refine: dict[str, Any]
    export: str
    workers: Annotated[int | None, Field(ge=1)]
    drapes: Annotated[int | None, Field(ge=0, le=4)]
    edge_mm: float
    density_g_m2: float | None
    warp_direction_deg: float | None
    strict: bool
    preview: bool


@dataclass(frozen=True)
class EstimateOptions:
    """How a capture is estimated: ``configs/infer.yaml`` in SI units."""

    refine: dict[str, Any] | None = None  # content of a file of ``configs/refine``
    drapes: int = 2  # to simulate with the estimate; 0: no report
    edge: Metres = 5e-3  # of their meshes at the plate's rim
    strict: bool = False  # refuse a faulty capture instead of giving warnings
    address: str = ""  # of the page that will show it, for the code in its report
    picture: str = ""  # name of a file that shows what was read, beside the report's
    thumbnail: str = ""  # the same, small


@dataclass
class EvaluateConfig:
    """``configs/evaluate.yaml``."""

    checkpoint: str
    testers: list[str]
    bounds: str
    out: str
    fabrics: str
    generate: list[str]
    fabrics_per_tester: FromOne
    drapes_per_fabric: FromOne
    even_fabrics: FromZero
    captures: FromOne
    seed: Seed
    workers: Workers


@dataclass
class ExportConfig:
    """``configs/export.yaml``; ranges: :class:`drapenet.export.material.ExportSettings`."""

    estimate: str
    to: str
    out: str
    name: str
    curvature_1_m: float
    mesh: str
    edge_mm: float


def _password(stated: Any) -> Any:
    return os.environ.get("DRAPENET_PASSWORD", "") if stated is None else stated


@dataclass
class ServeConfig:
    """``configs/serve.yaml``, and derived sizes in bytes and pixels and times in seconds."""

    host: Annotated[str, Field(min_length=1)]
    password: Annotated[str, BeforeValidator(_password)]
    open: bool
    port: Annotated[int, Field(ge=0, le=65535)]
    names: str
    address: str
    results: str
    checkpoint: str
    workers: Workers | None
    proxies: str
    queue: FromOne
    queue_each: FromOne
    job_seconds: Positive
    export_seconds: Positive
    look_seconds: Positive
    upload_seconds: Positive
    megabytes: Positive
    files: FromOne
    megapixels: Positive
    photograph_megapixels: Positive
    keep_hours: Positive
    keep: FromOne
    folder: Path = field(init=False)
    hosts: list[str] = field(init=False)
    processes: int = field(init=False)
    bytes: int = field(init=False)
    pixels: int = field(init=False)
    photograph_pixels: int = field(init=False)
    keep_seconds: float = field(init=False)

    def __post_init__(self) -> None:
        import joblib

        self.host = self.host.strip("[]")  # of an IPv6 address, as in a URL
        self.folder = Path(self.results).resolve()
        self.hosts = [name.strip() for name in self.names.split(",") if name.strip()]
        self.address = self.address.rstrip("/")
        self.processes = self.workers or joblib.cpu_count()
        self.bytes, self.pixels = round(self.megabytes * 1e6), round(self.megapixels * 1e6)
        self.photograph_pixels = round(self.photograph_megapixels * 1e6)
        self.keep_seconds = 3600 * self.keep_hours
