"""The coordinates in which mixtures and autoencoders see a fabric.

Bending ratios beta/alpha have a long tail (median -2.4 mm, lowest -17 mm), which arcsinh folds in
without a jump where beta changes its sign, and a few measurements that belong to no tail: they
are drawn in before fitting. What remains is shifted and scaled to mean 0 and deviation 1.
"""

from dataclasses import dataclass

import numpy as np

from common.errors import InputError
from data.fabrics import THETA_NAMES
from data.prior.base import Stored, array

BEND = 2e-3
"""beta/alpha, m, at which arcsinh turns from a straight line into a logarithm."""

MAX_DEVIATIONS = 4.0
"""Robust deviations (1.48 times the median distance from the median) beyond which a measurement
is drawn in: one of +40 mm and one of -17 mm among the 603 ratios of the published table."""

TOLERANCE = 1e-9
"""Coordinates that differ by less are equal but for rounding."""


def _compress(theta: np.ndarray) -> np.ndarray:
    return np.concatenate([theta[..., :3], np.arcsinh(theta[..., 3:] / BEND)], axis=-1)


def _expand(folded: np.ndarray) -> np.ndarray:
    return np.concatenate([folded[..., :3], BEND * np.sinh(folded[..., 3:])], axis=-1)


def plausible_range(theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Bounds (6,) and (6,) of theta, ``MAX_DEVIATIONS`` robust deviations around the medians of (F, 6).

    Drawing fabrics in to these bounds leaves the bounds as they are.
    """
    folded = _compress(theta)
    middle = np.median(folded, axis=0)
    deviation = 1.4826 * np.median(np.abs(folded - middle), axis=0)
    return _expand(middle - MAX_DEVIATIONS * deviation), _expand(middle + MAX_DEVIATIONS * deviation)


@dataclass(frozen=True, kw_only=True)
class Coordinates(Stored):
    """The map from theta to coordinates of mean 0 and deviation 1, one by one, and back.

    Attributes:
        mean: (6,) mean of (log alpha, arcsinh of beta/alpha over ``BEND``).
        scale: (6,) standard deviation, positive.
    """

    bend: array(check=lambda bend: "" if bend == BEND else f"must be {BEND:g} m") = BEND
    mean: array(6)
    scale: array(6, check=lambda scale: "" if (scale > 0).all() else "scales must be positive")

    @classmethod
    def fit(cls, theta: np.ndarray) -> tuple["Coordinates", np.ndarray]:
        """Fit to theta (F, 6); return also its coordinates (F, 6), outliers drawn in.

        Raises:
            InputError: most of the fabrics agree in a number, so that all others are outliers.
        """
        folded = _compress(np.clip(theta, *plausible_range(theta)))
        shared = np.flatnonzero(np.ptp(folded, axis=0) < TOLERANCE)
        if len(shared):
            raise InputError(f"more than half of the fabrics have the same {THETA_NAMES[shared[0]]}"
                             "; a prior needs fabrics that differ")
        coordinates = cls(mean=folded.mean(axis=0), scale=folded.std(axis=0))
        return coordinates, (folded - coordinates.mean) / coordinates.scale

    def encode(self, theta: np.ndarray) -> np.ndarray:
        """Coordinates (..., 6) of theta (..., 6); nothing is drawn in."""
        return (_compress(np.asarray(theta, dtype=np.float64)) - self.mean) / self.scale

    def decode(self, coordinates: np.ndarray) -> np.ndarray:
        """theta (..., 6) of coordinates (..., 6)."""
        return _expand(self.mean + self.scale * coordinates)

    def log_volume(self, theta: np.ndarray) -> np.ndarray:
        """Log of the volume of coordinates per volume of theta (..., 6), shape (...)."""
        slope = -0.5 * np.log(BEND**2 + theta[..., 3:] ** 2)
        return slope.sum(axis=-1) - np.log(self.scale).sum()
