"""A normal distribution of fabrics."""

from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np
from pydantic import AfterValidator

from common.errors import InputError
from common.types import Theta
from data.fabrics.fabrics import THETA_NAMES
from data.fabrics.prior.base import Count, Prior, array, require_fabrics

_ROUNDING = 1e-14  # of the largest variance; smaller eigenvalues are rounding errors


def _definite(covariance: np.ndarray) -> bool:
    """Whether a matrix is symmetric and, beyond rounding errors, positive definite."""
    variances = np.linalg.eigvalsh(covariance)
    return np.allclose(covariance, covariance.T) and variances[0] > _ROUNDING * variances[-1]


def _covariance(covariance: np.ndarray) -> np.ndarray:
    if not _definite(covariance):
        raise ValueError("the covariance must be symmetric and positive definite")
    return covariance


@dataclass(frozen=True, eq=False)
class GaussianPrior(Prior):
    """A normal distribution of theta, fitted to a number of ``fabrics``."""

    mean: Annotated[np.ndarray, array(6)]
    covariance: Annotated[np.ndarray, array(6, 6), AfterValidator(_covariance)]
    fabrics: Count
    kind: ClassVar[str] = "gaussian"

    TAIL: ClassVar[float] = 0.01
    """Share of the fabrics at each end of each parameter that is clipped to that quantile before
    fitting. Cantilever tests of very limp cloth give a few outliers of beta/alpha (one of +40 mm
    among 201, all others between -17 and +1), which would otherwise triple the standard deviation
    along the warp and make one fabric in ten stiffen when bent instead of one in a hundred."""

    @property
    def deviation(self) -> np.ndarray:
        """(6,) standard deviation of each component of theta."""
        return np.sqrt(np.diag(self.covariance))

    @classmethod
    def fit(cls, theta: Theta) -> "GaussianPrior":
        """Fit to distinct fabrics, more than six, with tails clipped at ``TAIL``."""
        require_fabrics(theta, 7)
        low, high = np.quantile(theta, [cls.TAIL, 1 - cls.TAIL], axis=0)
        clipped = np.clip(theta, low, high)
        covariance = np.cov(clipped.T)
        if not _definite(covariance):
            raise InputError("the fabrics of the table do not differ in six numbers "
                             f"({', '.join(THETA_NAMES)}) independent of each other, as "
                             "model=gaussian needs; measure more, or other ones")
        return cls(clipped.mean(axis=0), covariance, len(theta))

    def sample(self, n: int, rng: np.random.Generator) -> Theta:
        # Explicit factor: the factorisation in numpy's multivariate_normal may change.
        factor = np.linalg.cholesky(self.covariance)
        return self.mean + rng.standard_normal((n, 6)) @ factor.T
