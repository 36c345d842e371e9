"""Assembly of element blocks into the upper triangle of one sparse matrix."""

from collections.abc import Sequence

import numba
import numpy as np
from scipy import sparse


class SparsePattern:
    """Upper triangle (with diagonal) of the symmetric matrices that given stencils add up to.

    The structure is found once; :meth:`assemble` then only adds numbers.

    Args:
        stencils: for each energy, (N, K) int64 rows of the matrix, -1 for absent or held.
        size: number of rows.

    Attributes:
        indptr, indices: CSR structure, int32, sorted columns, every diagonal entry present.
    """

    def __init__(self, stencils: list[np.ndarray], size: int) -> None:
        self.size = size
        elements = [np.arange(size)[:, None], *stencils]  # every diagonal entry is there
        rows = np.concatenate([rows.ravel() for rows in elements])
        lengths = np.concatenate([np.full(len(rows), rows.shape[1]) for rows in elements])
        element, present = np.repeat(np.arange(len(lengths)), lengths), rows >= 0
        # Two rows meet where one element has both.
        ones = np.ones(present.sum(), dtype=np.float32)
        has = sparse.csr_matrix((ones, (element[present], rows[present])), (len(lengths), size))
        upper = sparse.triu(has.T @ has, format="csr")
        upper.sort_indices()
        self.indptr, self.indices = (v.astype(np.int32) for v in (upper.indptr, upper.indices))
        self.diagonal = self.indptr[:-1].copy()
        self._slots = [_slots(stencil, self.indptr, self.indices) for stencil in stencils]

    def assemble(self, blocks: Sequence[np.ndarray | None]) -> np.ndarray:
        """Sum of symmetric blocks (N, K, K), one array or None per stencil, as CSR data (nnz,)."""
        data = np.zeros(len(self.indices))
        for slots, block in zip(self._slots, blocks, strict=True):
            if block is not None:
                _scatter(data, slots, block)
        return data

    def symmetric(self, data: np.ndarray) -> sparse.csr_matrix:
        """The whole matrix as a SciPy matrix."""
        upper = sparse.csr_matrix((data, self.indices, self.indptr), shape=(self.size,) * 2)
        return (upper + sparse.triu(upper, 1).T).tocsr()


@numba.njit(cache=True)
def _slots(stencil, indptr, indices):
    """(N, K(K+1)/2) where the upper triangle of each block goes in the CSR data, -1: nowhere."""
    n, k = stencil.shape
    slots = np.full((n, k * (k + 1) // 2), -1, dtype=np.int32)
    for t in range(n):
        pair = -1
        for a in range(k):
            for b in range(a, k):
                pair += 1
                i, j = stencil[t, a], stencil[t, b]
                if i < 0 or j < 0:
                    continue
                i, j = min(i, j), max(i, j)
                low, high = indptr[i], indptr[i + 1] - 1
                while low < high:
                    middle = (low + high) // 2
                    if indices[middle] < j:
                        low = middle + 1
                    else:
                        high = middle
                slots[t, pair] = low
    return slots


@numba.njit(cache=True)
def _scatter(data, slots, blocks):
    n, k = blocks.shape[0], blocks.shape[1]
    for t in range(n):
        pair = -1
        for a in range(k):
            for b in range(a, k):
                pair += 1
                if slots[t, pair] >= 0:
                    data[slots[t, pair]] += blocks[t, a, b]
