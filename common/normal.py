"""Normal distributions, and linear evidence of a state in square-root information form.

Evidence is a list of whitened rows R and values v: of a state x, R x - v is a standard normal
vector. Its precision R'R cannot be indefinite, and evidence of independent sources is stacked
(Bierman 1977, Factorization methods for discrete sequential estimation).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import eigh

_FLOOR = 1e-6  # standard deviation relative to the mean, of what is constant over samples


@dataclass(frozen=True)
class Normal:
    """Mean (n,) and covariance (n, n)."""

    mean: np.ndarray
    covariance: np.ndarray

    @classmethod
    def of(cls, samples: np.ndarray) -> "Normal":
        """That of samples (S, n)."""
        mean = samples.mean(axis=0)
        floor = np.square(_FLOOR * (np.abs(mean) + _FLOOR))
        return cls(mean, np.cov(samples.T).reshape(samples.shape[1:] * 2) + np.diag(floor))

    def only(self, places: Sequence[int]) -> "Normal":
        """The marginal distribution of the entries at ``places``."""
        return Normal(self.mean[list(places)], self.covariance[np.ix_(places, places)])

    def updated(self, evidence: "Linear") -> "Normal":
        """The distribution of the state given evidence of it."""
        rows, covariance = evidence.rows, self.covariance
        gain = np.linalg.solve(rows @ covariance @ rows.T + np.eye(len(rows)), rows @ covariance).T
        # Joseph's form: positive definite whatever the rounding.
        left = np.eye(len(self.mean)) - gain @ rows
        return Normal(self.mean + gain @ (evidence.values - rows @ self.mean),
                      left @ covariance @ left.T + gain @ gain.T)

    def samples(self, count: int) -> np.ndarray:
        """Samples (count, n) by a fixed seed."""
        white = np.random.default_rng(0).standard_normal((count, len(self.mean)))
        return self.mean + white @ np.linalg.cholesky(self.covariance).T


@dataclass(frozen=True)
class Linear:
    """Evidence with rows R (m, n) and values v (m,): R x - v is standard normal."""

    rows: np.ndarray
    values: np.ndarray

    @classmethod
    def between(cls, prior: Normal, posterior: Normal, *, least: float = 1e-3) -> "Linear":
        """What leads from a prior to a posterior. In directions in which the posterior is as wide
        as the prior, or wider, it says nothing, as where its information is less than the share
        ``least`` of the prior's."""
        # In these axes, columns, the prior has the covariance 1, the posterior diag(shares).
        shares, axes = eigh(posterior.covariance, prior.covariance)
        shares = np.maximum(shares, 1e-12)
        telling = 1 / shares - 1 > least
        to_axes, shares = axes.T[telling], shares[telling]
        rows = np.sqrt(1 / shares - 1)[:, None] * to_axes
        moved = to_axes @ (posterior.mean - prior.mean) / shares
        return cls(rows, moved / np.sqrt(1 / shares - 1) + rows @ prior.mean)

    @classmethod
    def stacked(cls, parts: Sequence["Linear"]) -> "Linear":
        """That of independent sources of the same state together."""
        return cls(np.vstack([part.rows for part in parts]),
                   np.concatenate([part.values for part in parts]))

    def of_part(self, seen: np.ndarray) -> "Linear":
        """Evidence of a larger state y (N,), of which this one is ``seen`` (n, N) times y."""
        return Linear(self.rows @ seen, self.values)

    def moved(self, step: np.ndarray) -> "Linear":
        """That of the state plus ``step`` (n,)."""
        return Linear(self.rows, self.values + self.rows @ step)

    def scattered(self, covariance: np.ndarray) -> "Linear":
        """The same if what was measured differs from the state by an error (n, n)."""
        root = np.linalg.cholesky(np.eye(len(self.rows)) + self.rows @ covariance @ self.rows.T)
        return Linear(np.linalg.solve(root, self.rows), np.linalg.solve(root, self.values))
