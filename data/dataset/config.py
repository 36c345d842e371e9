"""Settings that determine the bytes of a dataset, and the keys of ``configs/generate.yaml``."""

import json
from dataclasses import asdict, dataclass, field, make_dataclass
from typing import Annotated

from pydantic import Field

from common.configs import Key, Seed, Share, Workers, keys_of, metres, pair, si, up_to
from common.errors import InputError
from common.types import Metres
from data.fabrics.nuisances import Kind, NuisanceConfig
from data.fabrics.prior import Prior, load_prior, prior_content
from data.fabrics.prior.even import SAME, WHOLE, Shares
from data.rigs import named_tester
from sim.mesh.specimen import EDGE_RANGE
from sim.rig import SQUARE_RIG
from sim.start import LOWERED
from sim.start import STARTS as SHAPES

VERSION = 2
"""Of drapes and their records: raise it when the same settings give other bytes. Datasets that were
begun with another one are neither finished nor extended."""
STARTS = (LOWERED, *SHAPES)  # initial states that need no other drape
BORROWED = "borrowed"  # an earlier drape of another fabric in the same shard
Count = Annotated[int, Field(ge=1)]


@dataclass(frozen=True)
class SamplingConfig:
    """Settings that determine the drapes of a dataset, besides prior and solver, documented in
    ``configs/dataset`` and ``configs/nuisances``.
    """

    seed: int = 0
    starts_per_fabric: Count = 2
    starts: tuple[str, ...] = (LOWERED,)
    testers: tuple[str, ...] = (SQUARE_RIG.name,)
    random_testers: float = 0.0
    rectangles: float = 0.0
    testers_per_fabric: int = 1
    specimens_per_fabric: Annotated[int, Field(ge=0)] = 0  # 0: another for each drape
    both_faces: bool = False
    drift: Annotated[Metres, Key("mm", up_to(20))] = 0.003
    even_share: Annotated[float, Field(ge=0, le=1)] = 0.0
    anisotropy: Annotated[Shares, Key("", pair(up_to(1)))] = WHOLE
    anisotropy_varied: Annotated[Shares, Key("", pair(up_to(2)))] = SAME
    rounded_rims: Annotated[float, Key("", Share)] = 0.0
    nuisances: NuisanceConfig = field(default_factory=NuisanceConfig)

    def __post_init__(self) -> None:
        for name in self.testers:
            named_tester(name)
        starts, drawn = list(self.starts), self.random_testers + self.rectangles
        for allowed, complaint in (
            (min(self.random_testers, self.rectangles) >= 0 and drawn <= 1
             and (self.testers or drawn == 1),
             f"random_testers={self.random_testers:g} and rectangles={self.rectangles:g} must not "
             "be negative; their sum must be at most 1, and be 1 without testers"),
            (1 <= self.testers_per_fabric <= self.starts_per_fabric,
             f"testers_per_fabric={self.testers_per_fabric} must lie between 1 and "
             f"starts_per_fabric={self.starts_per_fabric}"),
            (self.specimens_per_fabric % self.testers_per_fabric == 0,
             f"specimens_per_fabric={self.specimens_per_fabric} must be 0 or a multiple of "
             f"testers_per_fabric={self.testers_per_fabric}: a specimen fits its tester alone"),
            (set(starts) <= {*STARTS, BORROWED},
             f"starts={starts} must contain only {', '.join(STARTS)}, {BORROWED}"),
            (set(starts) & set(STARTS), f"starts={starts} must contain {' or '.join(STARTS)}: the "
             "first drapes have nothing to borrow"),
            (BORROWED not in starts or (len(self.testers) == 1 and not drawn),
             f"starts={starts}: drapes of one tester only can be {BORROWED}; give a single name in "
             "testers"),
        ):
            if not allowed:
                raise InputError(complaint)


@dataclass(frozen=True)
class DatasetConfig:
    """All settings that determine a dataset's bytes."""

    drapes: int
    sampling: SamplingConfig
    prior: Prior
    edge: Metres | None = None  # of the finest meshes at the rim; None: as of single drapes
    drapes_per_shard: int = 64
    # Of PyTorch, on which drapes are made in batches (:mod:`data.dataset.batches`); None: none.
    device: str | None = None

    def __post_init__(self) -> None:
        if self.edge is not None and not EDGE_RANGE[0] <= self.edge <= EDGE_RANGE[1]:
            raise InputError(f"edge_mm={1e3 * self.edge:g}: give null, for a mesh that suits each "
                             f"fabric, or {1e3 * EDGE_RANGE[0]:g} to {1e3 * EDGE_RANGE[1]:g} mm")

    def as_dict(self) -> dict:
        """Settings that determine each drape and its record, in JSON types."""
        solver: dict[str, object] = {
            "edge_mm": None if self.edge is None else round(1e3 * self.edge, 6)}
        if self.device:
            solver["device"] = self.device.partition(":")[0]
        settings = {
            "sampling": asdict(self.sampling),
            "prior": prior_content(self.prior),
            "solver": solver,
            "storage": {"drapes_per_shard": self.drapes_per_shard},
            "version": VERSION,
        }
        return json.loads(json.dumps(settings))  # tuples are lists in JSON

    def rows(self, shard: int) -> range:
        """Indices of the drapes in a shard."""
        first = shard * self.drapes_per_shard
        return range(first, min(first + self.drapes_per_shard, self.drapes))

    @property
    def shards(self) -> int:
        """Number of shards."""
        return -(-self.drapes // self.drapes_per_shard)


DatasetOptions = make_dataclass("DatasetOptions", [
    *keys_of(SamplingConfig, without=("seed", "nuisances")).items(), ("drapes_per_shard", Count)])
"""The group ``dataset``; see ``configs/dataset``."""
KindOptions = make_dataclass("KindOptions", keys_of(Kind).items())
"""A kind of cloth in the next."""
NuisanceOptions = make_dataclass("NuisanceOptions", (
    keys_of(NuisanceConfig) | {"cloth": dict[str, KindOptions]}).items())  # type: ignore[valid-type]
"""The group ``nuisances``; see ``configs/nuisances``."""


@dataclass
class PriorOptions:
    """The group ``prior``; see ``configs/prior``."""

    file: str


@dataclass
class Options:
    """Types of the keys of ``configs/generate.yaml``."""

    out: str
    drapes: Count
    workers: Workers
    part: Annotated[int, Field(ge=0)]
    parts: Count
    seed: Seed
    edge_mm: float | None
    device: str | None
    dataset: DatasetOptions  # type: ignore[valid-type]
    prior: PriorOptions
    nuisances: NuisanceOptions  # type: ignore[valid-type]


def config_from_options(options: Options) -> DatasetConfig:
    """Dataset configuration of the composed options."""
    dataset = si(asdict(options.dataset))
    return DatasetConfig(
        drapes=options.drapes,
        drapes_per_shard=dataset.pop("drapes_per_shard"),
        sampling=SamplingConfig(seed=options.seed, **dataset,
                                nuisances=NuisanceConfig.of_options(asdict(options.nuisances))),
        prior=load_prior(options.prior.file),
        edge=metres(options.edge_mm),
        device=options.device,
    )
