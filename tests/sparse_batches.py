"""The sparse solver of single drapes, for batches: what the batched one is checked against."""

from concurrent.futures import ThreadPoolExecutor
from queue import SimpleQueue

import numpy as np
import torch

from sim.linear import SparsePattern, make_solver


class SparseSolver:
    """One sample after the other on each of some threads, by the sparse solver of single drapes.

    Always in double precision: which precision that solver would choose depends on the matrices
    it has seen, here those of other samples.

    Args:
        pattern: of the matrices.
        threads: how many samples at a time.
    """

    def __init__(self, pattern: SparsePattern, *, threads: int = 1) -> None:
        self._pool = ThreadPoolExecutor(threads)
        self._free: SimpleQueue = SimpleQueue()
        for _ in range(threads):
            self._free.put(make_solver(pattern))

    def solve(self, data: torch.Tensor, rhs: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """See :meth:`sim.batched.objective.BatchedSolver.solve`."""
        definite = np.zeros(len(data), dtype=bool)
        solution = np.zeros(rhs.shape)
        matrices, right = data.numpy(), rhs.numpy()

        def one(k: int) -> None:
            solver = self._free.get()
            try:
                if np.isfinite(matrices[k]).all():
                    definite[k] = solver.factorise(matrices[k])
                if definite[k]:
                    solution[k] = solver.solve(right[k])
            finally:
                self._free.put(solver)

        list(self._pool.map(one, range(len(data))))
        return torch.from_numpy(definite), torch.from_numpy(solution)
