"""Captures as a network reads them, in training, validation and evaluation: random sets of them,
with photographs, reported numbers and marked faces drawn at random. Outlines have errors of
photographs over the mat (``python -m data.dataset.reading``), and faults in silence."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import cache, partial
from pathlib import Path
from typing import get_args

import numpy as np

from data.fabrics.fabrics import ClothProperties
from drapenet.config import Input, ModelConfig
from drapenet.network.dataset import Maps
from drapenet.network.inputs import Batch, Facts
from drapenet.network.targets import (
    CURL,
    Symmetry,
    TargetScale,
    exchanged,
    stiffer_first,
    targets_of,
)
from drapenet.views.directions import AZIMUTH, AZIMUTHS
from drapenet.views.outline import PERSPECTIVES, drape_coefficients

BUNDLED = Path(__file__).resolve().parents[2] / "data" / "weights" / "reading.npz"
_TIMES = (0.3, 1.3)  # of the errors of the file, least and most
_FAULTY = 0.3  # share of outlines with a bite or a bulge that nothing tells of
_WIDE = np.radians(3.0), np.radians(20.0)  # half its width, least and most
_EDGE = 0.1, 1.0  # share of that in which it rises, least and most
_HIGH = 0.03  # of half a size, its deviation
_ORDERS = np.arange(40)  # of their waves
_ALIKE = 0.3, 20.0  # those that count, least and most
CURLED = 10.0  # 1/m, natural curvature of cloth that counts as curled
_MEAN_SAMPLE = 1000  # captures used for mean and deviation of the distances
LEAST_HEIGHT = 0.5  # m, of the camera above the plate
PICTURE_OFFSET = 0.010  # of the outline's centre, in half sizes: 1.5 mm of a specimen of 300 mm
PICTURE_SCALE = 0.007  # of millimetres per pixel
PICTURE_NOISE = 0.008  # largest deviation of a radius, in half sizes
COEFFICIENT_ERROR = 0.010  # of drape coefficients as reported
RIM_ERROR = 0.3e-3  # m, of what is stated
MEMBRANE_ERROR = 0.15  # the same of the logarithm


@cache
def _stored() -> tuple[np.ndarray, np.ndarray]:
    with np.load(BUNDLED, allow_pickle=False) as arrays:
        return arrays["off"].astype(np.float32), arrays["stated"].astype(np.float32)


def reading_errors(count: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Errors (N, AZIMUTHS) of outlines as they are read, and those stated, half sizes."""
    stored = _stored()
    rows = rng.integers(len(stored[0]), size=count)
    turn = rng.uniform(0, 2 * np.pi, count)
    low, high = np.log(_TIMES)
    way = rng.choice([-1, 1], count)
    times = np.exp(rng.uniform(low, high, count))
    azimuth = np.arange(stored[0].shape[1]) * (2 * np.pi / stored[0].shape[1])
    off, stated = (np.array([
        size * np.interp(one * AZIMUTH + start, azimuth, values, period=2 * np.pi)
        for values, start, one, size in zip(part[rows], turn, way, times, strict=True)])
        .reshape(count, AZIMUTHS) for part in stored)
    return off, stated


def stated_errors(
    count: int, rng: np.random.Generator, sizes: tuple[float, float]
) -> tuple[np.ndarray, np.ndarray]:
    """Errors (N, AZIMUTHS) of whole hems or of one side, and their deviations, half sizes."""
    low, high = np.log([sizes, _ALIKE]).T
    size, order = np.exp(rng.uniform(low, high, (count, 2))).T[..., None]
    middle = rng.uniform(0, 2 * np.pi, (count, 1))
    wide = rng.uniform(0.2, 1.5, (count, 1))
    away = np.abs((AZIMUTH - middle + np.pi) % (2 * np.pi) - np.pi) / wide
    stated = size * np.where(rng.random((count, 1)) < 0.5, 1, np.exp(-away**2 / 2))
    power = np.exp(-np.square(_ORDERS / order))
    parts = rng.standard_normal((2, *power.shape)) * np.sqrt(
        power / power.sum(axis=1, keepdims=True))
    waves = np.outer(_ORDERS, AZIMUTH)
    return stated * (parts[0] @ np.cos(waves) + parts[1] @ np.sin(waves)), stated


def outline_faults(count: int, rng: np.random.Generator) -> np.ndarray:
    """Errors (N, AZIMUTHS), in half sizes, of bites and bulges, most without any."""
    middle = rng.uniform(0, 2 * np.pi, (count, 1))
    wide = rng.uniform(*_WIDE, (count, 1))
    edge = rng.uniform(*_EDGE, (count, 1))
    high = _HIGH * rng.standard_normal((count, 1)) * (rng.random((count, 1)) < _FAULTY)
    away = np.abs((AZIMUTH - middle + np.pi) % (2 * np.pi) - np.pi) / wide
    return high * np.square(np.sin(np.clip((1 - away) / edge, 0, 1) * np.pi / 2))


@dataclass(frozen=True)
class Condition:
    """What the captures of a set are: shares. Outlines have the small errors of a drapemeter's
    picture. Where some are ``read``, as photographs over the mat, all may have silent faults."""

    kinds: tuple[float, float, float] = (0.5, 0.42, 0.08)  # depth, outline, numbers alone
    sizes: tuple[float, ...] = (0.5, 0.2, 0.1, 0.2)  # sets of 1, 2, ... captures, of other drapes
    known: float = 0.7  # sets in which the direction of the warp is stated
    parallel: float = 0.3  # outlines under parallel light
    stated: float = 0.8  # of the other outlines, those whose camera's height is stated
    read: float = 0.0
    doubted: float = 0.0  # outlines with stated errors, of these sizes, half sizes, least and most
    errors: tuple[float, float] = (2e-3, 0.1)
    rim: float = 0.0  # sets in which the plates' rims are stated, as of the following
    membrane: float = 0.0
    kind: float = 0.0  # of cloth

    @classmethod
    def of_inputs(cls, inputs: Sequence[Input]) -> "Condition":
        """The default, with the shares of the kinds of captures that are ``inputs``."""
        shares = [share * (kind in inputs)
                  for kind, share in zip(get_args(Input), cls.kinds, strict=True)]
        total = sum(shares)
        depth, outline, numbers = (share / total for share in shares)
        return cls((depth, outline, numbers), read=0.5, doubted=0.15, rim=0.3, membrane=0.3,
                   kind=0.4)


def readable(maps: Maps, inputs: Sequence[Input]) -> np.ndarray:
    """Mask (N,) of the captures of use to a network of ``inputs``: of all there is an outline."""
    return (maps.views > 0) | (set(inputs) != {"depth"})


class CaptureSet:
    """Captures with the fabrics they show; ``scale`` of the targets is fitted if None."""

    def __init__(self, maps: Maps, *, scale: TargetScale | None = None) -> None:
        self.maps = maps
        # Neighbours of a fabric may have the same moduli by chance.
        _, first, which = np.unique(np.column_stack([maps.theta, maps.membrane]), axis=0,
                                    return_index=True, return_inverse=True)
        order = np.argsort(which.ravel(), kind="stable")
        self.members = np.split(order, np.cumsum(np.bincount(which.ravel()))[:-1])
        drapes = [len(np.unique(maps.index[rows])) for rows in self.members]
        self.turns = np.repeat(np.arange(len(self.members)), drapes)
        curl = np.array([maps.curl[rows].mean(axis=0) for rows in self.members])
        self.kind = maps.kind[first]
        self.cloth = ClothProperties(maps.theta[first], curl, maps.membrane[first],
                                     maps.hysteresis[first])
        middle = np.exp(np.array([np.log(maps.size[rows]).mean() for rows in self.members]))
        self.scale = scale or TargetScale.fit(targets_of(self.cloth, middle))

    def __len__(self) -> int:
        return len(self.members)

    @property
    def curled(self) -> np.ndarray:
        """Mask (N,) of the cloth that counts as curled."""
        return np.abs(self.cloth.curl).max(axis=1) > CURLED

    def network(self, config: ModelConfig) -> dict:
        """Arguments of :func:`drapenet.network.model.make_network` for these captures."""
        read = self.maps.pictures if config.backbone else self.maps.distance
        sample = read[self.maps.depth[self.maps.depth >= 0][:_MEAN_SAMPLE]].astype(np.float32)
        return {**asdict(config), "distance": round(float(np.nanmean(sample)), 4),
                "spread": round(float(np.nanstd(sample)), 4),
                "rectangles": bool((self.maps.aspect != 1).any()), "expected": True}

    def batch(
        self, cloths: np.ndarray, condition: Condition, rng: np.random.Generator, *,
        symmetric: bool = True,
    ) -> tuple[Batch, Facts]:
        """A random set of captures of each of ``cloths`` (M,), and the facts of its captures;
        ``symmetric``: whether captures are turned at random."""
        maps, rows, group = self.maps, [], []
        sizes = rng.choice(len(condition.sizes), size=len(cloths), p=condition.sizes) + 1
        for number, (cloth, size) in enumerate(zip(cloths, sizes, strict=True)):
            candidates = rng.permutation(self.members[cloth])
            _, first = np.unique(maps.index[candidates], return_index=True)
            rows.append(candidates[rng.permutation(first)[:size]])
            group += [number] * len(rows[-1])
        rows, group = np.concatenate(rows), np.array(group)
        known = rng.random(len(cloths)) < condition.known
        flip = rng.choice([-1, 1], size=len(cloths))  # the face that is marked is arbitrary
        kind = np.array([rng.choice(3, p=condition.kinds) for _ in rows])
        other = 2 if condition.kinds[2] and not condition.kinds[1] else 1
        kind[(maps.views[rows] == 0) & (kind == 0)] = other
        deep, seen = kind == 0, kind == 1
        ratio, stated = _perspectives(maps.size[rows], condition, rng)
        views = maps.depth_views(rows, deep)
        outline = views["hem"].astype(np.float32)
        outline[seen] = _photographed(maps.silhouettes[rows[seen]], ratio[seen], rng)
        error = np.zeros_like(outline)
        if condition.read or condition.doubted:
            outline[seen], error[seen] = _misread(outline[seen], condition, rng)
        radius = np.where((kind == 2)[:, None], maps.silhouettes[rows, 0], outline)
        coefficient = drape_coefficients(radius, maps.plate[rows], maps.disc[rows])
        coefficient += COEFFICIENT_ERROR * rng.standard_normal(len(rows)) * (kind == 2)
        counted = (kind == 2) & (rng.random(len(rows)) < 2 / 3)
        rounded, taut, sort = (rng.random(len(cloths)) < share for share in (
            condition.rim, condition.membrane, condition.kind))
        off = rng.standard_normal((2, len(cloths)))
        membrane = self.cloth.membrane[cloths] * np.exp(MEMBRANE_ERROR * off[0])
        rim = (maps.rim[rows] + RIM_ERROR * off[1, group]).clip(0.0)
        facts = Facts(
            size=maps.size[rows], plate=maps.plate[rows], disc=maps.disc[rows],
            aspect=maps.aspect[rows], face=maps.face[rows] * flip[group], known=known[group],
            views=np.where(deep, maps.views[rows], 0), perspective=np.where(
                deep, 0.0, np.where(seen & stated, ratio, np.nan)),
            coefficient=coefficient, nodes=np.where(counted, maps.folds[rows], np.nan),
            rim=np.where(rounded[group], rim, np.nan),
            membrane=np.where(taut, membrane, np.nan)[group],
            kind=np.where(sort, self.kind[cloths], -1)[group], group=group)
        targets = targets_of(self.cloth.chosen(cloths), facts.sizes)
        targets[flip < 0, CURL] *= -1
        targets[~known] = stiffer_first(targets[~known])
        weft = symmetric & known & (rng.random(len(cloths)) < 0.5)  # along azimuth 0
        targets = exchanged(targets, weft)
        turn = Symmetry.draw(known=known[group], disc=maps.disc[rows], exchanged=weft[group],
                             rng=rng) if symmetric else None

        batch = Batch.of(
            views["distance"], views["weight"], outline, error, facts, views["pictures"],
            views["angle"], self.scale.encode(targets))
        return batch.turned(turn) if turn else batch, facts

    def epoch(
        self, *, seed: int, epoch: int, size: int, condition: Condition = Condition()
    ) -> Iterator[Batch]:
        """As many sets of each fabric and neighbour as it has drapes in random order, a function of
        (seed, epoch)."""
        rng = np.random.default_rng([seed, epoch])
        order = rng.permutation(self.turns)
        for start in range(0, len(order) - size + 1, size):
            yield self.batch(order[start : start + size], condition, rng)[0]


def _perspectives(
    size: np.ndarray, condition: Condition, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Sizes (N,) over the camera's height, and whether they are stated, with an error of 3 %."""
    parallel = rng.random(len(size)) < condition.parallel
    ratio = np.where(parallel, 0.0, size * rng.uniform(0, 1 / LEAST_HEIGHT, len(size)))
    return ratio, rng.random(len(size)) < condition.stated


def _photographed(
    silhouettes: np.ndarray, ratio: np.ndarray, rng: np.random.Generator
) -> np.ndarray:
    """Outlines (N, AZIMUTHS) of photographs, from exact ones (N, P, AZIMUTHS), in half sizes."""
    place = np.interp(ratio, PERSPECTIVES, np.arange(len(PERSPECTIVES)))
    low = np.minimum(place.astype(int), len(PERSPECTIVES) - 2)
    share = (place - low)[:, None]
    rows = np.arange(len(ratio))
    radius = silhouettes[rows, low] * (1 - share) + silhouettes[rows, low + 1] * share
    aside = rng.normal(0, PICTURE_OFFSET, (len(ratio), 2))
    radius = radius + aside[:, :1] * np.cos(AZIMUTH) + aside[:, 1:] * np.sin(AZIMUTH)
    radius *= 1 + rng.normal(0, PICTURE_SCALE, (len(ratio), 1))
    noise = rng.standard_normal(radius.shape)
    smooth = (np.roll(noise, 1, axis=1) + noise + np.roll(noise, -1, axis=1)) / math.sqrt(3)
    return radius + PICTURE_NOISE * rng.random((len(ratio), 1)) * smooth


def _misread(
    radius: np.ndarray, condition: Condition, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Outlines (N, AZIMUTHS), half sizes, with faults and errors of a ``condition``; and those that
    are stated with them, 0 of others."""
    over_mat, doubted = rng.random((2, len(radius))) < [[condition.read], [condition.doubted]]
    off = outline_faults(len(radius), rng)
    stated = np.zeros_like(radius)
    of_size = partial(stated_errors, sizes=condition.errors)
    for rows, errors in ((over_mat, reading_errors), (doubted, of_size)):
        more, given = errors(int(rows.sum()), rng)
        off[rows] += more
        stated[rows] = np.hypot(stated[rows], given)
    return radius + off, stated
