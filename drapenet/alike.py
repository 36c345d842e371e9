"""Fabrics that cannot be told apart, by the samples of their estimates.

Two fabrics are *alike* if along warp, bias and weft their stiffness in a drape (the secant at 60
1/m, at the density of each) differs by no more than that of two specimens of one fabric, a factor
of :data:`ALIKE`, and so do shear and stretch where both are measured, and their densities by no
more than :data:`~data.readings.quantity.MAX_DENSITY_DIFFERENCE`. Where the warp of either is not
marked, stiff, bias and soft are compared; with published fabrics, KES B as published.

The share p of pairs of samples that are alike in bending is the probability of two fabrics chosen
blindly, of which a share q is alike (:data:`UNLIKE`). The probability of two that were, before they
were measured, as likely alike as not is

    p (1 - q) / (p (1 - q) + q (1 - p)),

times those of being alike in weight, shear and stretch. :attr:`Likeness.highest` is what it would
be if the medians were equal; below :data:`KNOWN` the two are not known well enough.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from scipy.special import ndtr

from common.types import Density
from data.readings import QUANTITIES
from data.readings.kes import GF_CM
from data.readings.laboratory import SOURCES, laboratory_rows
from data.readings.quantity import MAX_DENSITY_DIFFERENCE, SPECIMEN_SCATTER
from drapenet.measured.tension.record import TensionRecord
from drapenet.result.estimate import Estimate
from drapenet.result.files import read_estimate
from sim.material import DIRECTIONS, DRAPE_CURVATURE, FIRST, MICRO, SECOND, STIFF_SOFT, secant

ALIKE = 2.39 * 2**0.5 * SPECIMEN_SCATTER
"""Of logarithms: nineteen of twenty pairs of specimens differ by less along all directions."""
UNLIKE = (0.28, 0.09, 0.06)
"""Mean share p over pairs of different fabrics, of nine with outlines of real drapes, by the number
of stiffnesses that are compared."""
KNOWN = 0.7
STEP = 0.1
"""Of probabilities in lists: UNLIKE is not known better."""
_DENSITY_ERROR = 0.03  # standard deviation of the logarithm of a stated one; assumed
_KES, _KES_NAMES = QUANTITIES["kes_b_gf_cm2_per_cm"], ("warp", "weft", "mean")


@dataclass(frozen=True)
class Candidate:
    """A fabric that is compared.

    Attributes:
        place: of its result; of a published fabric, which has a ``source``, empty.
        stiffness: (S, Q) samples of its logarithm, N·m, along ``names``; of KES B if published.
        kes: (S, 3) the same of KES B along warp and weft, and of their mean.
        measured: median and deviation of the logarithm of shear and stretch.
    """

    name: str
    place: str
    density: Density
    names: tuple[str, ...]
    stiffness: np.ndarray
    kes: np.ndarray | None = None
    measured: dict[str, tuple[float, float]] = field(default_factory=dict)
    source: str = ""

    @property
    def values(self) -> dict[str, float]:
        """Medians of the stiffness, µN·m."""
        middle = np.exp(np.median(self.stiffness, axis=0)) / MICRO
        return dict(zip(self.names, middle.tolist(), strict=True))


def candidate(
    estimate: Estimate, name: str = "", place: str = "", tension: TensionRecord | None = None
) -> Candidate:
    """An estimate as it is compared, with shear and stretch of strips under weights."""
    b = GF_CM * _KES.of(estimate.cloth, estimate.density)[:, [FIRST, SECOND]]
    kes = np.log(np.column_stack([b, b.mean(axis=1)]))
    measured = {key.removesuffix("_n_per_m"): (
        float(np.log(value.median)), float(np.diff(np.log(value.interval_68))[0] / 2))
        for key, value in (tension.columns() if tension else {}).items() if value}
    stiffness = np.log(secant(DRAPE_CURVATURE, *estimate.moduli()))
    return Candidate(name, place, estimate.density, estimate.names, stiffness, kes, measured)


def read(folder: str | Path) -> Candidate:
    """The result in a folder, named as its captures state or by the folder; InputError if it is
    not sound."""
    estimate, document = read_estimate(Path(folder))
    name = document.capture.labels.fabric or str(folder)
    return candidate(estimate, name, str(folder), document.tension)


def typical() -> list[Candidate]:
    """Published fabrics, :mod:`data.readings.laboratory`, with the errors of KES."""
    rng, found = np.random.default_rng(1), []
    for row in laboratory_rows():
        b = {name: MICRO * float(value) for name in _KES_NAMES
             if (value := row[f"bending_{name}_uNm"])}
        errors = _KES.error * rng.standard_normal((4000, len(b)))
        found.append(Candidate(f"{row['composition']}, {row['weave']}", "",
                               1e-3 * float(row["weight_g_m2"]), tuple(b),
                               np.log(list(b.values())) + errors, source=SOURCES[row["source"]]))
    return found


@dataclass(frozen=True)
class Likeness:
    """How alike a ``fabric`` is to one with which it was compared.

    Attributes:
        apart: differences of the logarithms of medians: of the stiffness along the directions
            compared, then of weight, shear and stretch.
        probability: that they cannot be told apart.
        highest: what it would be with their errors if the medians were equal.
    """

    fabric: Candidate
    apart: dict[str, float]
    probability: float
    highest: float

    @property
    def verdict(self) -> str:
        """The probability in words: in whole steps, if it could be high, or is low."""
        steps = round(self.probability / STEP)
        text = f"{100 * STEP * steps:.0f} %" if self.highest >= KNOWN else "not known"
        return text if steps else f"below {50 * STEP:.0f} %"

    def content(self) -> dict[str, Any]:
        """All by name; ``differences`` are words."""
        percent = {name: 100 * float(np.expm1(value)) for name, value in self.apart.items()}
        return {
            "fabric": self.fabric.name,
            "place": self.fabric.place,
            "source": self.fabric.source,
            "density_g_m2": 1e3 * self.fabric.density,
            "alike": self.verdict,
            "probability": self.probability,
            "highest": self.highest,
            "differences": ", ".join(
                f"{name.replace('_', ' ')} {value:+.0f}" for name, value in percent.items()) + " %",
            **{f"{name}_difference_percent": value for name, value in percent.items()},
            **{f"{name}_{'kes_b' if self.fabric.source else 'stiffness'}_uN_m": value
               for name, value in self.fabric.values.items()}}


def like(fabric: Candidate, others: Iterable[Candidate]) -> list[Likeness]:
    """The ``others`` by how alike they are to a fabric: the most probable first, in whole steps of
    :data:`STEP`, within which the smaller difference of the medians comes first."""
    rng = np.random.default_rng(0)  # pairs must not be of the same random numbers
    found = [_likeness(fabric, other, rng) for other in others]
    return sorted(found, key=lambda one: (-round(one.probability / STEP), np.square(
        [*one.apart.values()][:len(one.fabric.names)]).mean()))


def _likeness(fabric: Candidate, other: Candidate, rng: np.random.Generator) -> Likeness:
    names, mine, its = _compared(fabric, other)
    count = min(len(mine), len(its))
    gaps = its[rng.permutation(len(its))[:count]] - mine[:count]
    middle = np.median(its, axis=0) - np.median(mine, axis=0)
    direct = {"weight": (np.log(other.density / fabric.density), 2**0.5 * _DENSITY_ERROR,
                         np.log1p(MAX_DENSITY_DIFFERENCE))} | {
        key: (other.measured[key][0] - value, np.hypot(error, other.measured[key][1]), ALIKE)
        for key, (value, error) in fabric.measured.items() if key in other.measured}
    apart, errors, limits = np.array(list(direct.values())).T
    usual = UNLIKE[len(names) - 1]

    def probability(gaps: np.ndarray, apart: np.ndarray) -> float:
        share = (np.abs(gaps) <= ALIKE).all(axis=1).mean()
        even = share * (1 - usual) / (share * (1 - usual) + usual * (1 - share))
        near = ndtr((limits - apart) / errors) - ndtr((-limits - apart) / errors)
        return float(even * near.prod())

    differences = [*middle.tolist(), *apart.tolist()]
    return Likeness(other, dict(zip((*names, *direct), differences, strict=True)),
                    probability(gaps, apart), probability(gaps - middle, 0 * apart))


def _compared(
    fabric: Candidate, other: Candidate
) -> tuple[tuple[str, ...], np.ndarray, np.ndarray]:
    """Names of what two fabrics both have, and their samples."""
    mine, its, names = fabric.stiffness, other.stiffness, other.names
    if other.source and fabric.kes is not None:
        mine = fabric.kes[:, [_KES_NAMES.index(name) for name in names]]
    if len(names) == 1 or fabric.names == (DIRECTIONS if other.source else names):
        return names, mine, its
    mine, its = mine.copy(), its.copy()
    for part in (mine[:, ::len(names) - 1], its[:, ::len(names) - 1]):  # the stiffer yarns first
        part[:] = np.sort(part)[:, ::-1]
    return STIFF_SOFT[::2 if other.source else 1], mine, its
