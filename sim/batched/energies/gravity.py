"""Weight of the cloth."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from sim.batched.energies.base import ElementBatch, stack_elements, stack_places
from sim.energies.gravity import Gravity


@dataclass(frozen=True)
class BatchedGravity(ElementBatch):
    """Batched :class:`sim.energies.gravity.Gravity`.

    Attributes:
        weights: (B, N) N.
    """

    weights: Tensor

    @classmethod
    def stack(
        cls, energies: Sequence[Gravity], device: torch.device | str = "cpu"
    ) -> "BatchedGravity":
        weights = stack_elements([energy.weights for energy in energies], device, fill=0.0)
        return cls(**stack_places(energies, device), weights=weights)

    def value(self, q: Tensor) -> Tensor:
        return (self.weights * self.unknowns(q)[:, 0]).sum(1)

    def gradient(self, q: Tensor) -> Tensor:
        return self.weights[:, :, None]

    def hessian(self, q: Tensor, convexity: float) -> None:
        return None
