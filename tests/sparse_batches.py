"""The sparse solver of single drapes, for batches: what the batched one is checked against."""

import numpy as np
import torch

from sim.linear import SparsePattern, make_solver


class SparseSolver:
    """One sample after the other by the sparse solver of single drapes, in double precision.

    Takes the place of :class:`sim.linear.multifrontal.FrontalSolver` on a CPU. Every sample has a
    solver of its own, so that none's answers depend on what the others' matrices were.
    """

    def __init__(
        self, pattern: SparsePattern, places: np.ndarray | None = None, *, device: str = "cpu"
    ) -> None:
        self._pattern = pattern
        self._solvers: list = []

    def factorise(self, data: torch.Tensor) -> torch.Tensor:
        """(B,) bool of CSR data (B, nnz)."""
        while len(self._solvers) < len(data):
            self._solvers.append(make_solver(self._pattern))
        self._definite = [bool(np.isfinite(row).all()) and solver.factorise(row)
                          for solver, row in zip(self._solvers, data.numpy(), strict=False)]
        return torch.tensor(self._definite)

    def solve(self, rhs: torch.Tensor) -> torch.Tensor:
        """(B, n) solutions, NaN without a factor."""
        found = [solver.solve(row) if definite else np.full(len(row), np.nan)
                 for solver, definite, row in zip(self._solvers, self._definite, rhs.numpy(),
                                                  strict=False)]
        return torch.from_numpy(np.stack(found))
