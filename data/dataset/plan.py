"""The plan of a dataset: fabric, specimen and initial state of each drape.

All functions depend only on the dataset's seed and the index of a fabric or drape, so a drape does
not depend on the process that simulates it or on interruptions. A borrowed initial state depends
also on the outcomes of earlier drapes of the shard.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np

from common.errors import InputError
from data.fabrics.nuisances import NuisanceConfig, Nuisances
from data.fabrics.prior import Prior, is_soft, sample_admissible
from data.testers import MIN_OVERHANG, PLATES, SIZES, named_tester
from sim.rig import SQUARE_RIG, Rig
from sim.start import LOWERED
from sim.start import STARTS as SHAPES

STARTS = (LOWERED, *SHAPES)
"""Initial states that need no other drape."""
BORROWED = "borrowed"
"""The initial state is an earlier drape of another fabric in the same shard."""
_MAX_SOFT_SHARE = 0.5


class Stream(IntEnum):
    """Independent streams of random numbers; the values are part of a dataset's definition."""

    FABRIC = 0
    START = 1
    VIEWS = 2  # used by benchmarks that render a drape
    LENDER = 3
    CLOTH = 4
    SPECIMEN = 5
    TESTERS = 6
    FACES = 7


@dataclass(frozen=True)
class SamplingConfig:
    """Settings that determine the drapes of a dataset, besides prior and solver.

    Attributes:
        seed: seed of the dataset.
        starts_per_fabric: drapes of each fabric.
        starts: initial states, used in turn (Feng et al. 2022, section 5.2.1), from
            :data:`STARTS` and :data:`BORROWED`.
        testers: names of testers, drawn with equal probability.
        random_testers: share of testers that are drawn from the ranges of :mod:`data.testers`.
        testers_per_fabric: number of testers drawn for each fabric; its drapes use each in turn.
        both_faces: whether the fabric's face up is drawn for each drape, both faces at least once;
            else its marked face is up.
        drift: standard deviation of the specimen's offset from the plate's axis, m, along warp
            and weft each.
        soft_share: share of fabrics that are drawn from the soft ones of the prior, see
            :func:`data.fabrics.prior.is_soft`; the others are drawn from the full prior.
        nuisances: their distributions.
    """

    seed: int = 0
    starts_per_fabric: int = 2
    starts: tuple[str, ...] = (LOWERED,)
    testers: tuple[str, ...] = (SQUARE_RIG.name,)
    random_testers: float = 0.0
    testers_per_fabric: int = 1
    both_faces: bool = False
    drift: float = 0.003
    soft_share: float = 0.0
    nuisances: NuisanceConfig = field(default_factory=NuisanceConfig)

    def __post_init__(self) -> None:
        for name in ("starts", "testers"):
            object.__setattr__(self, name, tuple(getattr(self, name)))
        for name in self.testers:
            named_tester(name)
        if not 0 <= self.random_testers <= 1 or not (self.testers or self.random_testers == 1):
            raise InputError(f"random_testers={self.random_testers:g} must lie between 0 and 1, "
                             "and be 1 without testers")
        if not 1 <= self.testers_per_fabric <= self.starts_per_fabric:
            raise InputError(f"testers_per_fabric={self.testers_per_fabric} must lie between 1 and "
                             f"starts_per_fabric={self.starts_per_fabric}")
        if BORROWED in self.starts and self.only_tester is None:
            raise InputError(f"starts={list(self.starts)}: drapes of one tester only can be "
                             f"{BORROWED}; give a single name in testers")
        if self.seed < 0:
            raise InputError(f"seed={self.seed} must not be negative")
        if self.starts_per_fabric < 1:
            raise InputError(f"starts_per_fabric={self.starts_per_fabric} must be at least 1")
        if not set(self.starts) <= {*STARTS, BORROWED}:
            raise InputError(f"starts={list(self.starts)} must contain only {', '.join(STARTS)}, "
                             f"{BORROWED}")
        if not set(self.starts) & set(STARTS):
            raise InputError(f"starts={list(self.starts)} must contain "
                             f"{' or '.join(STARTS)}: the first drapes have nothing to borrow")
        if not 0 <= self.drift <= 0.02:
            raise InputError(f"drift_mm={self.drift * 1e3:g} must lie between 0 and 20")
        if not 0 <= self.soft_share <= _MAX_SOFT_SHARE:
            raise InputError(f"soft_share={self.soft_share:g} must lie between 0 and "
                             f"{_MAX_SOFT_SHARE:g}")


    @property
    def only_tester(self) -> Rig | None:
        """The tester of all drapes; None if there are several."""
        if self.random_testers or len(self.testers) != 1:
            return None
        return named_tester(self.testers[0])


@dataclass(frozen=True)
class DrapePlan:
    """The settings of one drape.

    Attributes:
        index: position in the dataset.
        fabric: index of the fabric; drapes of one fabric share theta.
        theta: (6,) parameters, see :mod:`data.fabrics.fabrics`.
        rejected: number of inadmissible samples drawn before this fabric.
        weight: importance weight, density of the prior at theta over that of the drawn fabrics.
        rig: tester with its nominal sizes.
        face: 1 if the fabric's marked face is up, -1 if it is down.
        nuisances: of the specimen.
        start: initial state, one of :data:`STARTS` or :data:`BORROWED`.
        fallback: one of :data:`STARTS`, for a borrowed start without a lender; else ``start``.
        seed: seed of the mesh and of the initial state.
        offset: (2,) specimen's centre relative to the plate's axis, along warp and weft, m.
    """

    index: int
    fabric: int
    theta: np.ndarray
    rejected: int
    weight: float
    rig: Rig
    face: int
    nuisances: Nuisances
    start: str
    fallback: str
    seed: int
    offset: np.ndarray


def stream(seed: int, kind: Stream, index: int) -> np.random.Generator:
    """Random generator of the stream ``kind`` for the fabric or drape ``index``."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(int(kind), index)))


def plan_drape(index: int, *, config: SamplingConfig, prior: Prior) -> DrapePlan:
    """The plan of drape ``index``; consecutive drapes share a fabric."""
    fabric, start_of_fabric = divmod(index, config.starts_per_fabric)
    theta, rejected, weight = draw_fabric(prior, stream(config.seed, Stream.FABRIC, fabric),
                                          soft_share=config.soft_share)
    rig = draw_testers(config, fabric)[start_of_fabric % config.testers_per_fabric]
    face = draw_faces(config, fabric)[start_of_fabric]
    nuisances = config.nuisances.sample(stream(config.seed, Stream.CLOTH, fabric),
                                        stream(config.seed, Stream.SPECIMEN, index), face=face)
    rng = stream(config.seed, Stream.START, index)
    # With one drape per fabric the initial states alternate between fabrics.
    start = config.starts[(fabric + start_of_fabric) % len(config.starts)]
    others = [name for name in config.starts if name != BORROWED]
    fallback = others[(fabric + start_of_fabric) % len(others)] if start == BORROWED else start
    seed = int(rng.integers(2**31))
    offset = rng.normal(0.0, config.drift, 2)
    return DrapePlan(index, fabric, theta, rejected, weight, rig, face, nuisances, start, fallback,
                     seed, offset)


def draw_testers(config: SamplingConfig, fabric: int) -> list[Rig]:
    """The testers of a fabric, with sizes in whole millimetres."""
    rng, drawn = stream(config.seed, Stream.TESTERS, fabric), []
    for _ in range(config.testers_per_fabric):
        if rng.random() >= config.random_testers:
            drawn.append(named_tester(config.testers[rng.integers(len(config.testers))]))
            continue
        specimen, size = ("square", "disc")[rng.integers(2)], round(rng.uniform(*SIZES))
        plate = round(rng.uniform(PLATES[0], min(PLATES[1], size - 2 * MIN_OVERHANG)))
        drawn.append(Rig(size / 1e3, plate / 1e3, specimen))
    return drawn


def draw_faces(config: SamplingConfig, fabric: int) -> list[int]:
    """:attr:`DrapePlan.face` of each drape of a fabric."""
    count = config.starts_per_fabric
    if not config.both_faces:
        return [1] * count
    faces = stream(config.seed, Stream.FACES, fabric).choice([1, -1], size=count).tolist()
    if count > 1 and abs(sum(faces)) == count:
        faces[-1] *= -1
    return faces


def draw_fabric(
    prior: Prior, rng: np.random.Generator, *, soft_share: float = 0.0
) -> tuple[np.ndarray, int, float]:
    """theta (6,), the number of rejected inadmissible samples, and :attr:`DrapePlan.weight`."""
    theta, rejected = sample_admissible(prior, rng)
    if not soft_share:
        return theta, rejected, 1.0
    if rng.random() < soft_share:
        while not is_soft(theta):
            theta, more = sample_admissible(prior, rng)
            rejected += more
    return theta, rejected, 1 / (1 - soft_share + soft_share * is_soft(theta) / prior.soft_share)


def choose_lender(index: int, *, seed: int, candidates: Sequence[int]) -> int:
    """Choose the initial state of drape ``index`` among the drapes ``candidates``, uniformly."""
    rng = stream(seed, Stream.LENDER, index)
    return candidates[rng.integers(len(candidates))]
