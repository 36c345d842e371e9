"""The network behind :mod:`drapenet.network.expected`: the distribution of a shape given cloth and
specimen."""

import math

import torch

from drapenet.network.expected import SHAPE
from drapenet.network.targets import CURL, TARGETS

_COMPONENTS = 4
_HIDDEN = 64


class Expected(torch.nn.Module):
    """Mixture of normal distributions, each with independent entries, of a shape given the
    standardised targets of its cloth and ``facts`` numbers of the capture."""

    def __init__(self, facts: int) -> None:
        super().__init__()
        self.layers = torch.nn.Sequential(
            torch.nn.Linear(TARGETS + facts, _HIDDEN), torch.nn.ReLU(),
            torch.nn.Linear(_HIDDEN, _HIDDEN), torch.nn.ReLU(),
            torch.nn.Linear(_HIDDEN, _COMPONENTS * (1 + 2 * SHAPE)))

    def forward(self, targets: torch.Tensor, facts: torch.Tensor, face: torch.Tensor
                ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Logarithms of the components' weights (..., K), means and logarithms of deviations
        (..., K, SHAPE) for targets (..., TARGETS) of the marked face, captures' facts and faces."""
        turned = targets.clone()
        turned[..., CURL] = targets[..., CURL] * face[..., None]
        out = self.layers(torch.cat([turned, facts], dim=-1))
        out = out.view(*out.shape[:-1], _COMPONENTS, 1 + 2 * SHAPE)
        return (out[..., 0].log_softmax(dim=-1), out[..., 1 : 1 + SHAPE],
                out[..., 1 + SHAPE :].clamp(-5.0, 3.0))

    def log_density(self, shape: torch.Tensor, targets: torch.Tensor, facts: torch.Tensor,
                    face: torch.Tensor) -> torch.Tensor:
        """(...) log density of the known numbers of shapes (..., SHAPE)."""
        return _log_density(shape, *self(targets, facts, face))


def _log_density(shape: torch.Tensor, weights: torch.Tensor, means: torch.Tensor,
                 deviations: torch.Tensor) -> torch.Tensor:
    known = shape.isfinite()[..., None, :]
    gap = (shape.nan_to_num()[..., None, :] - means) / deviations.exp()
    each = (-gap.square() / 2 - deviations - math.log(2 * math.pi) / 2) * known
    return (weights + each.sum(dim=-1)).logsumexp(dim=-1)
