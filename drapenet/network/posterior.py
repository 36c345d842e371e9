"""Posterior of the standardised targets as a mixture of Gaussians, and its calibration."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np

LEVELS = (0.50, 0.68, 0.90)

Samples = Annotated[np.ndarray, "(S, any, T) draws of T targets for N captures, or for all"]
Ranks = Annotated[np.ndarray, "(N, T) share of the draws below the truth; uniform if calibrated"]


@dataclass(frozen=True)
class Posterior:
    """Mixtures of K Gaussians over T targets, one for each of N captures."""

    logits: np.ndarray  # (N, K) of the components' weights, not normalised
    means: np.ndarray  # (N, K, T)
    factors: np.ndarray  # (N, K, T, T) lower triangular, precision = factor factorᵀ

    def sample(self, count: int, rng: np.random.Generator) -> Samples:
        """(count, N, T) draws."""
        chosen = chosen_components(self.logits, count, rng)
        white = rng.standard_normal((len(self.logits), count, self.means.shape[2]))
        inverse = np.linalg.inv(self.factors.astype(float))
        drawn = np.zeros_like(white)
        for k in range(self.logits.shape[1]):
            drawn += (chosen == k)[..., None] * (self.means[:, k, None] + white @ inverse[:, k])
        return drawn.swapaxes(0, 1)


def chosen_components(logits: np.ndarray, count: int, rng: np.random.Generator) -> np.ndarray:
    """(N, count) components drawn with the weights of ``logits`` (N, K), not normalised."""
    share = np.exp(logits - logits.max(axis=1, keepdims=True), dtype=float)
    total = np.cumsum(share, axis=1)
    drawn = rng.random((len(logits), count)) * total[:, -1:]
    return (drawn[..., None] >= total[:, None, :-1]).sum(axis=2)


def ranks(draws: Samples, truth: np.ndarray) -> Ranks:
    """Ranks of the truth (N, T) among the draws."""
    return (draws < truth).mean(axis=0)


def covered(places: Ranks) -> np.ndarray:
    """(L, N, T) whether the truth is inside the central intervals of :data:`LEVELS`."""
    return np.abs(places - 0.5) <= np.array(LEVELS)[:, None, None] / 2


def inside(places: Ranks) -> dict[str, float]:
    """Share of :func:`covered` truths, by level, such as "68%"."""
    return {f"{level:.0%}": share for level, share in
            zip(LEVELS, covered(places).mean(axis=(1, 2)).tolist(), strict=True)}
