"""The plan of a dataset: fabric, specimen and initial state of each drape.

All functions depend only on the dataset's seed and the index of a fabric or drape, except that a
borrowed initial state depends on the outcomes of earlier drapes of the shard.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np

from common.types import Theta
from data.dataset.config import BORROWED, SamplingConfig
from data.fabrics.nuisances import Nuisances
from data.fabrics.prior import Prior
from data.fabrics.prior.base import log_stiffness
from data.fabrics.prior.even import draw_fabric
from data.rigs import named_tester
from sim.rig import Rig

PLATES = (0.06, 0.25)  # m; of testers of random sizes, log-uniform, as the next
WIDTHS = (1.4, 3.0)  # of a specimen over its plate
SPECIMENS = (0.14, 0.4)  # m
RIMS = (0.5e-3, 6e-3)  # m, radius of a rounded rim; a tin's rolled rim has 2 to 5 mm
SHARP = 0.5e-3  # m, largest radius of others


class Stream(IntEnum):
    """Independent streams of random numbers; the values are part of a dataset's definition."""

    FABRIC = 0
    START = 1
    VIEWS = 2  # used by experiments that render a drape
    LENDER = 3
    CLOTH = 4
    SPECIMEN = 5
    TESTERS = 6
    FACES = 7


@dataclass(frozen=True)
class DrapePlan:
    """The settings of one drape, as stored (:func:`data.dataset.shards.fields`).

    Attributes:
        rig: tester with its nominal sizes, and its rim.
        start: initial state, one of :data:`data.dataset.config.STARTS` or borrowed.
        fallback: for a borrowed start without a lender; else ``start``.
        offset: (2,) specimen's centre relative to the plate's axis, along warp and weft, m.
    """

    index: int
    fabric: int
    theta: Theta
    rejected: int
    shift: float
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
    theta, rejected, shift = draw_fabric(prior, stream(config.seed, Stream.FABRIC, fabric),
                                         even_share=config.even_share,
                                         anisotropy=config.anisotropy,
                                         varied=config.anisotropy_varied)
    rig = draw_testers(config, fabric)[start_of_fabric % config.testers_per_fabric]
    face = draw_faces(config, fabric)[start_of_fabric]
    specimen = start_of_fabric % (config.specimens_per_fabric or config.starts_per_fabric)
    nuisances = draw_nuisances(config, fabric, index - start_of_fabric + specimen, theta, face)
    rng = stream(config.seed, Stream.START, index)
    # With one drape per fabric the initial states alternate between fabrics.
    start = config.starts[(fabric + start_of_fabric) % len(config.starts)]
    others = [name for name in config.starts if name != BORROWED]
    fallback = others[(fabric + start_of_fabric) % len(others)] if start == BORROWED else start
    seed = int(rng.integers(2**31))
    offset = rng.normal(0.0, config.drift, 2)
    # A specimen that leaves less than half of the overhang on a side would be laid again.
    offset *= min(1.0, rig.least_overhang / 2 / max(np.hypot(*offset), 1e-12))
    return DrapePlan(index, fabric, theta, rejected, shift, rig, face, nuisances, start, fallback,
                     seed, offset)


def draw_nuisances(
    config: SamplingConfig, fabric: int, index: int, theta: Theta, face: int = 1
) -> Nuisances:
    """Those of a ``fabric`` with these moduli and of its specimen that is first on drape ``index``.
    """
    return config.nuisances.sample(
        stream(config.seed, Stream.CLOTH, fabric), stream(config.seed, Stream.SPECIMEN, index),
        face=face, alpha=float(np.exp(log_stiffness(theta))))


def draw_testers(config: SamplingConfig, fabric: int) -> list[Rig]:
    """The testers of a fabric, with sizes in whole millimetres."""
    rng, testers = stream(config.seed, Stream.TESTERS, fabric), []
    for _ in range(config.testers_per_fabric):
        kind = rng.random()
        if kind >= config.random_testers + config.rectangles:
            rig = named_tester(config.testers[rng.integers(len(config.testers))])
        else:
            rig = _random_tester(rng, rectangle=kind >= config.random_testers)
        if config.rounded_rims:
            rounded = rng.random() < config.rounded_rims
            rig = replace(rig, rim=round(rng.uniform(*RIMS) if rounded else
                                         rng.uniform(0, SHARP), 5))
        testers.append(rig)
    return testers


def _random_tester(rng: np.random.Generator, *, rectangle: bool) -> Rig:
    """A plate, and a specimen whose sides are in proportion to it."""
    specimen = "rectangle" if rectangle else ("square", "disc")[rng.integers(2)]
    while True:
        plate, *widths = np.exp(rng.uniform(*np.log([PLATES, WIDTHS, WIDTHS]).T))
        sides = np.round(plate * np.array(widths if rectangle else widths[:1] * 2), 3)
        if SPECIMENS[0] <= sides.min() and sides.max() <= SPECIMENS[1]:
            return Rig(tuple(sides.tolist()), round(float(plate), 3), specimen)


def draw_faces(config: SamplingConfig, fabric: int) -> list[int]:
    """:attr:`DrapePlan.face` of each drape of a fabric."""
    count = config.starts_per_fabric
    if not config.both_faces:
        return [1] * count
    faces = stream(config.seed, Stream.FACES, fabric).choice([1, -1], size=count).tolist()
    if count > 1 and abs(sum(faces)) == count:
        faces[-1] *= -1
    return faces


def choose_lender(index: int, *, seed: int, candidates: Sequence[int]) -> int:
    """Choose the initial state of drape ``index`` among the drapes ``candidates``, uniformly."""
    rng = stream(seed, Stream.LENDER, index)
    return candidates[int(rng.integers(len(candidates)))]
