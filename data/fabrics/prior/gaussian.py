"""Gaussian prior: a normal distribution of theta."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from common.errors import InputError
from data.fabrics.fabrics import THETA_NAMES
from data.fabrics.prior.base import Count, Stored, array, check_fabrics, wrong_covariance


@dataclass(frozen=True)
class GaussianPrior(Stored):
    """A normal distribution of theta.

    Attributes:
        mean: (6,) mean of theta.
        covariance: (6, 6) covariance of theta, positive definite.
        fabrics: number of fabrics it was fitted to.
    """

    mean: array(6)
    covariance: array(6, 6, check=wrong_covariance)
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
    def fit(cls, theta: np.ndarray) -> "GaussianPrior":
        """Fit to the distinct fabrics theta (F, 6), F > 6, with tails clipped at ``TAIL``.

        Raises:
            InputError: fewer fabrics, or a singular covariance.
        """
        theta = check_fabrics(theta)
        low, high = np.quantile(theta, [cls.TAIL, 1 - cls.TAIL], axis=0)
        clipped = np.clip(theta, low, high)
        covariance = np.cov(clipped.T)
        if wrong_covariance(covariance):
            raise InputError("the fabrics of the table do not differ in six numbers "
                             f"({', '.join(THETA_NAMES)}) independent of each other, as "
                             "model=gaussian needs; measure more, or other ones")
        return cls(clipped.mean(axis=0), covariance, len(theta))

    def sample(self, n: int, rng: np.random.Generator) -> np.ndarray:
        """Draw theta (n, 6), admissible or not."""
        # Explicit factor: the factorisation in numpy's multivariate_normal may change.
        factor = np.linalg.cholesky(self.covariance)
        return self.mean + rng.standard_normal((n, 6)) @ factor.T

    def log_likelihood(self, theta: np.ndarray) -> np.ndarray:
        """Log density (n,) of theta (n, 6), per unit of theta."""
        white = np.linalg.solve(np.linalg.cholesky(self.covariance),
                                (np.atleast_2d(theta) - self.mean).T)
        log_volume = 0.5 * np.linalg.slogdet(self.covariance)[1] + 3 * np.log(2 * np.pi)
        return -0.5 * (white**2).sum(axis=0) - log_volume
