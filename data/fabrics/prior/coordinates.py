"""Coordinates of a fabric for mixtures and autoencoders.

Bending ratios beta/alpha have a long tail (median -2.4 mm, lowest -17 mm), which arcsinh compresses
smoothly across the sign of beta, and a few outliers, which are clipped before fitting. The result
is standardised to mean 0 and standard deviation 1.
"""

from dataclasses import dataclass

import numpy as np

from common.errors import InputError
from data.fabrics.fabrics import THETA_NAMES
from data.fabrics.prior.base import Stored, array

BEND = 2e-3
"""beta/alpha, m, at which arcsinh changes from linear to logarithmic."""

MAX_DEVIATIONS = 4.0
"""Robust standard deviations (1.48 times the median absolute deviation) beyond which a measurement
is clipped: one of +40 mm and one of -17 mm among the 603 ratios of the published table."""

TOLERANCE = 1e-9
"""Coordinates that differ by less are equal up to rounding."""


def _compress(theta: np.ndarray) -> np.ndarray:
    return np.concatenate([theta[..., :3], np.arcsinh(theta[..., 3:] / BEND)], axis=-1)


def _expand(folded: np.ndarray) -> np.ndarray:
    return np.concatenate([folded[..., :3], BEND * np.sinh(folded[..., 3:])], axis=-1)


def plausible_range(theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Bounds (6,) and (6,) of theta, from theta (F, 6) of fabrics.

    They are ``MAX_DEVIATIONS`` robust standard deviations from the medians. Clipping the fabrics to
    the bounds does not change the bounds.
    """
    folded = _compress(theta)
    middle = np.median(folded, axis=0)
    reach = MAX_DEVIATIONS * (1.4826 * np.median(np.abs(folded - middle), axis=0))
    return _expand(middle - reach), _expand(middle + reach)


@dataclass(frozen=True, kw_only=True)
class Coordinates(Stored):
    """Map between theta and coordinates, each standardised to mean 0 and standard deviation 1.

    Attributes:
        mean: (6,) mean of (log alpha, arcsinh of beta/alpha over ``BEND``).
        scale: (6,) standard deviation, positive.
    """

    bend: array(check=lambda bend: "" if bend == BEND else f"must be {BEND:g} m") = BEND
    mean: array(6)
    scale: array(6, check=lambda scale: "" if (scale > 0).all() else "scales must be positive")

    @classmethod
    def fit(cls, theta: np.ndarray) -> tuple["Coordinates", np.ndarray]:
        """Fit to theta (F, 6); return also its coordinates (F, 6), with outliers clipped.

        Raises:
            InputError: more than half of the fabrics have the same value of a parameter, so that
                all others are outliers.
        """
        folded = _compress(np.clip(theta, *plausible_range(theta)))
        shared = np.flatnonzero(np.ptp(folded, axis=0) < TOLERANCE)
        if len(shared):
            raise InputError(f"more than half of the fabrics have the same {THETA_NAMES[shared[0]]}"
                             "; a prior needs fabrics that differ")
        coordinates = cls(mean=folded.mean(axis=0), scale=folded.std(axis=0))
        return coordinates, (folded - coordinates.mean) / coordinates.scale

    def encode(self, theta: np.ndarray) -> np.ndarray:
        """Coordinates (..., 6) of theta (..., 6), without clipping."""
        return (_compress(np.asarray(theta, dtype=np.float64)) - self.mean) / self.scale

    def decode(self, coordinates: np.ndarray) -> np.ndarray:
        """theta (..., 6) of coordinates (..., 6)."""
        return _expand(self.mean + self.scale * coordinates)

    def log_volume(self, theta: np.ndarray) -> np.ndarray:
        """Log determinant (...) of the Jacobian of coordinates with respect to theta (..., 6)."""
        slope = -0.5 * np.log(BEND**2 + theta[..., 3:] ** 2)
        return slope.sum(axis=-1) - np.log(self.scale).sum()
