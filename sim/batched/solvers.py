"""Linear solvers for batches of matrices that share a pattern."""

import torch

from sim.linear.multifrontal import Analysis, BatchedCholesky


class FrontalSolver:
    """All samples at once, by :class:`sim.linear.multifrontal.BatchedCholesky`, on any device."""

    def __init__(self, analysis: Analysis) -> None:
        self._cholesky = BatchedCholesky(analysis)

    def solve(self, data: torch.Tensor, rhs: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """See :meth:`sim.batched.objective.BatchedSolver.solve`."""
        definite = self._cholesky.factorise(data)
        return definite, self._cholesky.solve(rhs)
