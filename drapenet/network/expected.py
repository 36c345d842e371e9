"""How the drapes of a cloth look: what a network expects of a capture whose cloth is known.

A capture is described by a few numbers, its *shape*. The network of a checkpoint has beside the
posterior of the cloth given a capture the distribution of the shape given cloth and specimen,
learned from the same drapes. If a capture's shape is improbable for all cloths of its posterior,
the capture is unlike the drapes that were learned: a posterior predictive check (Gelman et al.
1996).
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from common.findings import Finding
from common.types import Metres
from drapenet.network.posterior import chosen_components
from drapenet.views.directions import AZIMUTH

SHAPE = 5
"""Numbers of a shape: the drape coefficient, the logarithms of the rms of waves around the outline
and of its distance from the axis, the mean order of the waves, and the number of nodes."""
_WAVES = np.arange(2, 21)
_LEAST = 1e-3  # half sizes, of a wave
_LEAST_DISTANCE = 1e-2  # below it, a drape is as good as centred
_UNIT = np.array([0.25, 1.0, 1.0, 3.0, 3.0])
REPLICATES = 500  # drapes of a posterior that a capture is compared with
LEVEL = 0.01
"""Largest share of a posterior's own drapes that may be less probable than a capture's."""


def shape_of(outline: np.ndarray, coefficient: np.ndarray, nodes: np.ndarray) -> np.ndarray:
    """(N, SHAPE) numbers, about 1, of outlines (N, AZIMUTHS) in half sizes, NaN where not seen,
    and of the coefficients and nodes (N,) that are known; NaN: not known."""
    shape = np.full((len(outline), SHAPE), np.nan)
    shape[:, 0], shape[:, 4] = coefficient, nodes
    seen = np.isfinite(outline)
    cells = np.arange(outline.shape[1])
    rows = np.flatnonzero(seen.mean(axis=1) >= 0.5)
    radius = np.array(outline[rows], float)
    for one, part in zip(radius, seen[rows], strict=True):
        if not part.all():
            one[:] = np.interp(cells, cells[part], one[part], period=len(cells))
    waves = np.abs(radius @ _TURNS.T)
    power = np.square(waves[:, 1:]) + _LEAST**2 / len(_WAVES)
    total = power.sum(axis=1)
    shape[rows, 1:4] = np.column_stack([np.log(total) / 2,
                                        np.log(np.hypot(waves[:, 0], _LEAST_DISTANCE)),
                                        power @ _WAVES / total])
    return shape / _UNIT


_TURNS = 2 * np.exp(-1j * np.outer(np.r_[1, _WAVES], AZIMUTH)) / len(AZIMUTH)


@dataclass(frozen=True)
class Likeness:
    """How a capture compares with drapes of its posterior."""

    probability: float  # share of these drapes that are less probable than the capture
    number: int  # the number of its shape that deviates most
    value: float  # this number
    low: float  # from here to ``high`` 99 % of those drapes have it
    high: float

    @classmethod
    def of(cls, probability: float, shape: np.ndarray, drawn: np.ndarray) -> "Likeness":
        """Of a capture's shape (SHAPE,), beside drapes' (S, SHAPE)."""
        low, middle, high = np.quantile(drawn, [0.005, 0.5, 0.995], axis=0)
        away = np.where(np.isfinite(shape), np.abs(shape - middle) / (high - low), -1.0)
        worst = int(away.argmax())
        return cls(probability, worst, *(float(each[worst] * _UNIT[worst])
                                         for each in (shape, low, high)))

    def warning(self, size: Metres, causes: str) -> Finding | None:
        """A finding if the capture of a specimen of ``size`` is unlike its posterior's drapes;
        ``causes``: what to check then, the likeliest first."""
        if self.probability >= LEVEL:
            return None
        code, of = _CODES[self.number]
        return Finding(code, {"value": of(self.value, size), "low": of(self.low, size),
                              "high": of(self.high, size), "causes": causes})


def _millimetres(value: float, size: Metres) -> float:
    return 1e3 * math.exp(value) * size / 2


_CODES: tuple[tuple[str, Callable[[float, Metres], float]], ...] = (
    ("unlike_coefficient", lambda value, size: 100 * value), ("unlike_depth", _millimetres),
    ("unlike_offset", _millimetres), ("unlike_folds", lambda value, size: value),
    ("unlike_nodes", lambda value, size: value))


def likeness(
    shape: np.ndarray, weights: np.ndarray, means: np.ndarray, deviations: np.ndarray
) -> list[Likeness]:
    """How N captures with shapes (N, SHAPE) compare with drapes of cloths drawn from their
    posteriors, whose shapes have the distributions of
    :class:`drapenet.network.model.Expected`: logarithms (S, N, K) of weights, means and
    logarithms (S, N, K, SHAPE) of deviations."""
    rng, found = np.random.default_rng(0), []
    for n, own in enumerate(shape):
        parts = weights[:, n], means[:, n], deviations[:, n]
        rows = np.arange(len(weights))
        chosen = chosen_components(parts[0], 1, rng)[:, 0]
        drawn = parts[1][rows, chosen] + np.exp(parts[2][rows, chosen]) * rng.standard_normal(
            (len(rows), SHAPE))
        density = log_density_of_all(np.vstack([drawn, own]), np.isfinite(own), *parts)
        less = (1 + (density[:-1] <= density[-1]).sum()) / (1 + len(rows))
        found.append(Likeness.of(float(less), own, drawn))
    return found


def log_density_of_all(shapes: np.ndarray, known: np.ndarray, weights: np.ndarray,
                       means: np.ndarray, deviations: np.ndarray) -> np.ndarray:
    """(M,) log densities of the ``known`` numbers of ``shapes`` (M, SHAPE), under the sum of the
    mixtures of S cloths (S, K, ...)."""
    # Differences of large numbers: in double precision.
    middles, widths = (part.reshape(-1, SHAPE)[:, known].astype(float)
                       for part in (means, deviations))
    points = shapes[:, known].astype(float)
    exact = np.exp(-2 * widths)
    squares = np.square(points) @ exact.T - 2 * points @ (middles * exact).T
    offsets = ((np.square(middles) * exact).sum(axis=1) / 2 + widths.sum(axis=1)
               + known.sum() * math.log(2 * math.pi) / 2)
    each = weights.ravel() - (squares / 2 + offsets)
    most = each.max(axis=1)
    return most + np.log(np.exp(each - most[:, None]).sum(axis=1))
