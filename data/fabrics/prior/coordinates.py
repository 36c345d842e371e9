"""Standardised coordinates of fabrics, in which an autoencoder reads them."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from pydantic import AfterValidator

from common.errors import InputError
from common.types import Theta
from data.fabrics.fabrics import THETA_NAMES
from data.fabrics.prior.base import TOLERANCE, Stored, array

BEND = 2e-3
"""beta/alpha, m, at which arcsinh changes from linear to logarithmic."""

MAX_DEVIATIONS = 4.0
"""Robust standard deviations (1.48 times the median absolute deviation) beyond which a measurement
is clipped: one of +40 mm and one of -17 mm among the 603 ratios of the published table."""


def _compress(theta: Theta) -> np.ndarray:
    return np.concatenate([theta[..., :3], np.arcsinh(theta[..., 3:] / BEND)], axis=-1)


def _expand(folded: np.ndarray) -> Theta:
    return np.concatenate([folded[..., :3], BEND * np.sinh(folded[..., 3:])], axis=-1)


def plausible_range(theta: Theta) -> tuple[Theta, Theta]:
    """Bounds ``MAX_DEVIATIONS`` from the medians of fabrics, which clipping does not change."""
    folded = _compress(theta)
    middle = np.median(folded, axis=0)
    reach = MAX_DEVIATIONS * (1.4826 * np.median(np.abs(folded - middle), axis=0))
    return _expand(middle - reach), _expand(middle + reach)


def _positive(scale: np.ndarray) -> np.ndarray:
    if not (scale > 0).all():
        raise ValueError("scales must be positive")
    return scale


@dataclass(frozen=True, eq=False)
class Coordinates(Stored):
    """Map between theta and the standardised coordinates (..., 6) of an autoencoder: log alpha, and
    arcsinh of beta/alpha over ``BEND``, less ``mean`` (6,), over ``scale`` (6,).

    Bending ratios beta/alpha have a long tail (median -2.4 mm, lowest -17 mm), which arcsinh
    compresses smoothly across the sign of beta, and a few outliers, which are clipped before
    fitting.
    """

    mean: Annotated[np.ndarray, array(6)]
    scale: Annotated[np.ndarray, array(6), AfterValidator(_positive)]

    def as_dict(self) -> dict:
        """All parameters, in JSON types, and the constant :data:`BEND`."""
        return {"bend": BEND} | super().as_dict()

    @classmethod
    def fit(cls, theta: Theta) -> tuple["Coordinates", np.ndarray]:
        """Fit to fabrics; return also their coordinates, with outliers clipped."""
        folded = _compress(np.clip(theta, *plausible_range(theta)))
        shared = np.flatnonzero(np.ptp(folded, axis=0) < TOLERANCE)
        if len(shared):
            raise InputError(f"more than half of the fabrics have the same {THETA_NAMES[shared[0]]}"
                             "; a prior needs fabrics that differ")
        coordinates = cls(mean=folded.mean(axis=0), scale=folded.std(axis=0))
        return coordinates, (folded - coordinates.mean) / coordinates.scale

    def encode(self, theta: Theta) -> np.ndarray:
        """Coordinates of theta, without clipping."""
        return (_compress(np.asarray(theta, dtype=np.float64)) - self.mean) / self.scale

    def decode(self, coordinates: np.ndarray) -> Theta:
        """Theta of coordinates."""
        return _expand(self.mean + self.scale * coordinates)
