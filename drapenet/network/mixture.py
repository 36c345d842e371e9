"""Mixtures of Gaussians as a network learns them."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch.nn.functional import softplus

from drapenet.network.posterior import Posterior

_MIN_DIAGONAL = 1e-2  # minimum of a factor's diagonal; standardised targets


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
        parts = outputs.view(outputs.shape[0], components, 1 + targets + entries)
        logits, means, entries = parts.split([1, targets, entries], dim=2)
        rows, columns = torch.tril_indices(targets, targets, device=outputs.device)
        factors = outputs.new_zeros(*means.shape, targets)
        factors[..., rows, columns] = torch.where(
            rows == columns, softplus(entries) + _MIN_DIAGONAL, entries)
        return cls(logits[..., 0], means, factors)

    @classmethod
    def around(cls, means: torch.Tensor, factor: torch.Tensor) -> "Mixture":
        """Normal distributions about means (N, T), all with the precision of ``factor`` (T, T)."""
        return cls(means.new_zeros(means.shape[0], 1), means[:, None],
                   factor.expand(means.shape[0], 1, *factor.shape))

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
        each = (volume - 0.5 * white.square().sum(dim=-1)
                - gap.shape[-1] / 2 * math.log(2 * math.pi))
        return torch.logsumexp(each + self.logits.log_softmax(dim=1), dim=-1)

    @property
    def mean(self) -> torch.Tensor:
        """(N, T) mean of the mixture."""
        return (self.logits.softmax(dim=1)[..., None] * self.means).sum(dim=1)

    def widened(self, scale: float) -> "Mixture":
        """The mixture whose components deviate ``scale`` times as much from their means."""
        return Mixture(self.logits, self.means, self.factors / scale)

    def cpu(self) -> "Mixture":
        """The mixture in float32 on the CPU."""
        return Mixture(*(part.float().cpu() for part in vars(self).values()))

    @property
    def posterior(self) -> Posterior:
        """The same in arrays."""
        return Posterior(*(part.numpy() for part in vars(self.cpu()).values()))


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
