"""A mixture of normal distributions (Feng et al. 2022, section 5.1.3, Table 1), by scikit-learn."""

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np
from scipy.special import logsumexp

from common.errors import InputError
from data.fabrics.prior.base import Count, Stored, array, check_fabrics, wrong_covariance
from data.fabrics.prior.coordinates import Coordinates

ITERATIONS = 200  # of expectation maximisation, as in the paper
INITIALISATIONS = 5
VARIANCE_FLOOR = 0.05
"""Added to the variances of every component, relative to those of the table. With the library's
default of 1e-6, a component of thirty fabrics overfits: 0.2 nats less per unseen fabric."""


def _wrong_weights(weights: np.ndarray) -> str:
    right = (weights > 0).all() and abs(weights.sum() - 1) < 1e-9
    return "" if right else "the weights of a mixture must be positive and add up to 1"


@dataclass(frozen=True)
class MixturePrior(Stored):
    """A mixture of K normal distributions with full covariances.

    Attributes:
        coordinates: in which the components are normal.
        weights: (K,) shares, positive, of sum 1.
        means: (K, 6) in coordinates.
        covariances: (K, 6, 6) in coordinates, positive definite.
        fabrics: number of fabrics it was fitted to.
    """

    coordinates: Coordinates
    weights: array(None, check=_wrong_weights)
    means: array(None, 6)
    covariances: array(None, 6, 6, check=wrong_covariance)
    fabrics: Count
    kind: ClassVar[str] = "mixture"

    def __post_init__(self) -> None:
        if not len(self.weights) == len(self.means) == len(self.covariances):
            raise InputError("weights, means and covariances of a mixture must be equal in number")

    @classmethod
    def fit(cls, theta: np.ndarray, *, components: int = 3, seed: int = 0) -> "MixturePrior":
        """Fit ``components`` normal distributions to the distinct fabrics theta (F, 6).

        Raises:
            InputError: fewer than 7 fabrics per component.
        """
        # Imported late: reading and sampling do not need it.
        from sklearn.mixture import GaussianMixture

        theta = check_fabrics(theta, least=7 * components)
        coordinates, points = Coordinates.fit(theta)
        fitted = GaussianMixture(components, max_iter=ITERATIONS, n_init=INITIALISATIONS,
                                 reg_covar=VARIANCE_FLOOR, random_state=seed).fit(points)
        return cls(coordinates, fitted.weights_, fitted.means_, fitted.covariances_, len(theta))

    @cached_property
    def _factors(self) -> np.ndarray:
        return np.linalg.cholesky(self.covariances)

    def sample(self, n: int, rng: np.random.Generator) -> np.ndarray:
        """Draw theta (n, 6), admissible or not."""
        bounds = np.cumsum(self.weights)[:-1]
        points = np.empty((n, 6))
        for point in points:  # one by one, so that the first samples do not depend on n
            component = np.searchsorted(bounds, rng.random(), side="right")
            point[:] = self.means[component] + self._factors[component] @ rng.standard_normal(6)
        return self.coordinates.decode(points)

    def log_likelihood(self, theta: np.ndarray) -> np.ndarray:
        """Log density (n,) of theta (n, 6), per unit of theta."""
        theta = np.atleast_2d(theta)
        away = self.coordinates.encode(theta)[:, None] - self.means
        white = np.linalg.solve(self._factors, away[..., None])[..., 0]
        log_volume = np.log(np.diagonal(self._factors, axis1=1, axis2=2)).sum(axis=1)
        terms = (np.log(self.weights) - 0.5 * (white**2).sum(axis=-1) - log_volume
                 - 3 * np.log(2 * np.pi))
        return logsumexp(terms, axis=1) + self.coordinates.log_volume(theta)

    def as_dict(self) -> dict:
        """All parameters, in JSON types."""
        found = super().as_dict()
        return {"coordinates": found.pop("coordinates"), "components": len(self.weights), **found}
