"""Assembly of element blocks into the upper triangle of a sparse matrix."""

from collections.abc import Sequence

import numba
import numpy as np
from scipy import sparse


class SparsePattern:
    """Pattern of the upper triangle (with diagonal) of symmetric matrices assembled from stencils.

    The structure is computed once; :meth:`assemble` only adds values.

    Args:
        stencils: for each energy, (N, K) int64 rows of the matrix, -1 for absent or held.
        size: number of rows.

    Attributes:
        indptr, indices: CSR structure, int32, sorted columns, every diagonal entry present.
    """

    def __init__(self, stencils: list[np.ndarray], size: int) -> None:
        self.size = size
        elements = [np.arange(size)[:, None], *stencils]  # every diagonal entry is present
        rows = np.concatenate([rows.ravel() for rows in elements])
        lengths = np.concatenate([np.full(len(rows), rows.shape[1]) for rows in elements])
        element, present = np.repeat(np.arange(len(lengths)), lengths), rows >= 0
        # Entry (i, j) is present if one element has both rows.
        ones = np.ones(present.sum(), dtype=np.float32)
        has = sparse.csr_matrix((ones, (element[present], rows[present])), (len(lengths), size))
        upper = sparse.triu(has.T @ has, format="csr")
        upper.sort_indices()
        self.indptr, self.indices = (v.astype(np.int32) for v in (upper.indptr, upper.indices))
        self.diagonal = self.indptr[:-1].copy()
        self._slots = [_slots(stencil, self.indptr, self.indices) for stencil in stencils]

    def assemble(self, blocks: Sequence[np.ndarray | None]) -> np.ndarray:
        """CSR data (nnz,) of the sum of symmetric blocks: (N, K, K) or None for each stencil."""
        data = np.zeros(len(self.indices))
        for slots, block in zip(self._slots, blocks, strict=True):
            if block is not None:
                _scatter(data, slots, block)
        return data

    def symmetric(self, data: np.ndarray) -> sparse.csr_matrix:
        """The full symmetric SciPy matrix of the CSR data (nnz,)."""
        upper = sparse.csr_matrix((data, self.indices, self.indptr), shape=(self.size,) * 2)
        return (upper + sparse.triu(upper, 1).T).tocsr()


@numba.njit(cache=True)
def _slots(stencil, indptr, indices):
    """Indices (N, K(K+1)/2) of the upper triangle of each block in the CSR data; -1: absent."""
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
