"""What a minimisation of many samples asks of its functions and of its linear solver."""

from collections.abc import Iterator
from typing import Protocol

import numpy as np
import torch

from sim.linear import SparsePattern


class Hessians(Protocol):
    """The Hessians of a batch at one point, assembled as far as they are asked for.

    They are in coordinates of the objective's choice, see :class:`sim.newton.Objective`.
    """

    def systems(
        self, index: np.ndarray, convexity: np.ndarray, shift: np.ndarray
    ) -> Iterator[tuple[np.ndarray, SparsePattern, torch.Tensor]]:
        """The matrices of some samples, those of one pattern together.

        Args:
            index: (b,) int64, the samples.
            convexity: (b,) as in :meth:`sim.energies.base.Energy.hessian`.
            shift: (b,) multiples of the regularisation that are added to the diagonals.

        Yields:
            Which of the b they are, (c,) int64, their pattern and CSR data (c, nnz).
        """

    def into_frames(self, index: np.ndarray, gradient: torch.Tensor) -> torch.Tensor: ...

    def out_of_frames(self, index: np.ndarray, move: torch.Tensor) -> torch.Tensor: ...


class BatchedObjective(Protocol):
    """What is minimised: B functions of n unknowns.

    :class:`sim.batched.potential.BatchedPotential` is one.

    Points, gradients and steps are (B, n) float64 on one device, figures (B,).
    """

    def value(self, y: torch.Tensor) -> torch.Tensor: ...

    def gradient(self, y: torch.Tensor) -> torch.Tensor: ...

    def hessians(self, y: torch.Tensor) -> Hessians: ...

    def allows(self, old: torch.Tensor, new: torch.Tensor) -> torch.Tensor: ...

    def residual(self, gradient: torch.Tensor) -> torch.Tensor: ...

    def step_length(self, step: torch.Tensor) -> torch.Tensor: ...

    def take(self, index: torch.Tensor) -> "BatchedObjective":
        """The functions ``index`` (b,) int64 alone."""


class BatchedSolver(Protocol):
    """Solves symmetric systems of one pattern if their matrices are positive definite."""

    def solve(self, data: torch.Tensor, rhs: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Whether each matrix, CSR data (b, nnz), is positive definite, and the solutions (b, n).

        Solutions for matrices that are not mean nothing. ``rhs`` is (b, n). A sample's answers
        do not depend on the others.
        """


def part_of(objective: BatchedObjective, index: np.ndarray, y: torch.Tensor) -> BatchedObjective:
    """The functions ``index`` (b,), ascending, of those that belong to ``y`` (B, n)."""
    return objective if len(index) == len(y) else objective.take(on_device(index, y))


def on_device(array: np.ndarray, like: torch.Tensor) -> torch.Tensor:
    """An array of the host on the device of a tensor."""
    return torch.from_numpy(array).to(like.device)


def on_host(tensor: torch.Tensor) -> np.ndarray:
    """A tensor as an array of the host."""
    return tensor.cpu().numpy()
