"""Posterior of the standardised targets as a mixture of Gaussians, and its calibration."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
import torch
from torch.nn.functional import softplus

LEVELS = (0.50, 0.68, 0.90)
_MIN_DIAGONAL = 1e-2  # minimum of a factor's diagonal; standardised targets

Samples = Annotated[np.ndarray, "(S, any, T) draws of T targets for N captures, or for all"]
Ranks = Annotated[np.ndarray, "(N, T) share of the draws below the truth; uniform if calibrated"]


@dataclass(frozen=True)
class Mixture:
    """Mixtures of K Gaussians over T targets, one for each of N captures."""

    logits: torch.Tensor  # (N, K) of the components' weights, not normalised
    means: torch.Tensor  # (N, K, T)
    factors: torch.Tensor  # (N, K, T, T) lower triangular, precision = factor factorᵀ

    @classmethod
    def of_outputs(cls, outputs: torch.Tensor, *, components: int, targets: int) -> "Mixture":
        """Mixture of outputs (N, O), O of :func:`outputs_of`."""
        entries = targets * (targets + 1) // 2
        parts = outputs.view(len(outputs), components, 1 + targets + entries)
        logits, means, entries = parts.split([1, targets, entries], dim=2)
        rows, columns = torch.tril_indices(targets, targets, device=outputs.device)
        factors = outputs.new_zeros(*means.shape, targets)
        factors[..., rows, columns] = torch.where(
            rows == columns, softplus(entries) + _MIN_DIAGONAL, entries)
        return cls(logits[..., 0], means, factors)

    @classmethod
    def around(cls, means: torch.Tensor, factor: torch.Tensor) -> "Mixture":
        """Normal distributions about means (N, T), all with the precision of ``factor`` (T, T)."""
        return cls(means.new_zeros(len(means), 1), means[:, None],
                   factor.expand(len(means), 1, *factor.shape))

    @classmethod
    def joined(cls, parts: Sequence["Mixture"]) -> "Mixture":
        """The mixtures of all ``parts``."""
        return cls(*(torch.cat(rows) for rows in
                     zip(*(vars(part).values() for part in parts), strict=True)))

    def log_likelihood(self, targets: torch.Tensor) -> torch.Tensor:
        """(N,) log density at targets (N, T)."""
        gap = targets[:, None] - self.means
        white = torch.einsum("nkji,nkj->nki", self.factors, gap)
        volume = self.factors.diagonal(dim1=2, dim2=3).log().sum(dim=2)
        each = (volume - 0.5 * white.square().sum(dim=2)
                - gap.shape[2] / 2 * math.log(2 * math.pi))
        return torch.logsumexp(each + self.logits.log_softmax(dim=1), dim=1)

    @property
    def mean(self) -> torch.Tensor:
        """(N, T) mean of the mixture."""
        return (self.logits.softmax(dim=1)[..., None] * self.means).sum(dim=1)

    def sample(self, count: int, generator: torch.Generator) -> torch.Tensor:
        """(count, N, T) draws; mixture and generator must be on the CPU."""
        shares = self.logits.softmax(dim=1)
        chosen = torch.multinomial(shares, count, replacement=True, generator=generator).T
        captures = torch.arange(len(shares))
        white = torch.randn(count, *self.means[:, 0].shape, 1, generator=generator)
        offset = torch.linalg.solve_triangular(
            self.factors[captures, chosen].transpose(-1, -2), white, upper=True)
        return self.means[captures, chosen] + offset[..., 0]

    def cpu(self) -> "Mixture":
        """The mixture in float32 on the CPU."""
        return Mixture(*(part.float().cpu() for part in (self.logits, self.means, self.factors)))


def outputs_of(*, components: int, targets: int) -> int:
    """Number of parameters of a mixture."""
    return components * (1 + targets + targets * (targets + 1) // 2)


def factor_of(residuals: torch.Tensor) -> torch.Tensor:
    """(T, T) factor, as in :class:`Mixture`, of the precision of residuals (N, T).

    Correlations are shrunk by as many pseudo-residuals without any as there are targets, so that
    few residuals give a covariance, too.
    """
    count, targets = residuals.shape
    moments = residuals.T @ residuals / count
    alone = targets / (targets + count)
    moments = (1 - alone) * moments + alone * moments.diagonal().diag()
    return torch.linalg.cholesky(torch.linalg.inv(moments.double())).float()


def ranks(draws: Samples, truth: np.ndarray) -> Ranks:
    """Ranks of the truth (N, T) among the draws."""
    return (draws < truth).mean(axis=0)


def covered(places: Ranks) -> np.ndarray:
    """(L, T) share of captures inside the central intervals of :data:`LEVELS`."""
    levels = np.array(LEVELS)[:, None, None]
    return (np.abs(places - 0.5) <= levels / 2).mean(axis=1)


def inside(places: Ranks) -> dict[str, float]:
    """:func:`covered` over all targets, by level, such as "68%"."""
    return {f"{level:.0%}": share for level, share in
            zip(LEVELS, covered(places).mean(axis=1).tolist(), strict=True)}
