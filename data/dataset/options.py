"""Schema of ``configs/generate.yaml``, and its conversion to a dataset configuration."""

from dataclasses import asdict, dataclass

from common.command import Seed, Workers
from common.errors import InputError
from common.units import si
from data.dataset.plan import SamplingConfig
from data.dataset.simulate import DatasetConfig
from data.fabrics.nuisances import NuisanceConfig
from data.fabrics.prior import load_prior


@dataclass
class DatasetOptions:
    """The group ``dataset``; see ``configs/dataset``."""

    starts_per_fabric: int
    starts: list[str]
    testers: list[str]
    random_testers: float
    testers_per_fabric: int
    both_faces: bool
    drift_mm: float
    soft_share: float
    drapes_per_shard: int


@dataclass
class PriorOptions:
    """The group ``prior``; see ``configs/prior``."""

    file: str


@dataclass
class NuisanceOptions:
    """The group ``nuisances``; see ``configs/nuisances``."""

    membrane_n_per_m: list[float]
    shear: list[float]
    hysteresis_per_m: list[float]
    curl_per_m: float
    curl_specimen_per_m: float
    size_mm: float
    plate_mm: float
    cut_deg: float


@dataclass
class Options:
    """Types of the keys of ``configs/generate.yaml``."""

    out: str
    drapes: int
    workers: Workers
    part: int
    parts: int
    seed: Seed
    edge_mm: float
    dataset: DatasetOptions
    prior: PriorOptions
    nuisances: NuisanceOptions


def config_from_options(options: Options) -> DatasetConfig:
    """Dataset configuration of the composed options; InputError for invalid values."""
    if options.parts < 1:
        raise InputError(f"parts={options.parts} must be at least 1")
    dataset = si(asdict(options.dataset))
    return DatasetConfig(
        drapes=options.drapes,
        drapes_per_shard=dataset.pop("drapes_per_shard"),
        sampling=SamplingConfig(seed=options.seed, **dataset,
                                nuisances=NuisanceConfig(**si(asdict(options.nuisances)))),
        prior=load_prior(options.prior.file),
        edge=options.edge_mm * 1e-3,
    )
