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
        alone = np.arange(size)[:, None]  # every diagonal entry is there
        elements = [alone, *stencils]
        first = np.cumsum(np.concatenate(
            [[0], *(np.full(len(rows), rows.shape[1]) for rows in elements)]))
        rows = np.concatenate([rows.ravel() for rows in elements])
        self.indptr, self.indices = _structure(first, rows, size)
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
def _structure(first, rows, size):
    """CSR structure of the upper triangle, sorted columns, of elements' pairs of rows. Element t
    has the rows (-1: none) from first[t] to first[t + 1]."""
    # The elements of each row, one row after the other.
    begin = np.zeros(size + 1, dtype=np.int64)
    for i in rows:
        if i >= 0:
            begin[i + 1] += 1
    begin = np.cumsum(begin)
    fill = begin[:-1].copy()
    owner = np.empty(begin[-1], dtype=np.int64)
    for t in range(len(first) - 1):
        for i in rows[first[t] : first[t + 1]]:
            if i >= 0:
                owner[fill[i]] = t
                fill[i] += 1

    seen = np.full(size, -1, dtype=np.int64)  # the last row that has each column
    indptr = np.zeros(size + 1, dtype=np.int32)
    indices = np.empty(32 * size, dtype=np.int32)
    count = 0
    for i in range(size):
        for t in owner[begin[i] : begin[i + 1]]:
            for j in rows[first[t] : first[t + 1]]:
                if j >= i and seen[j] != i:
                    seen[j] = i
                    if count == len(indices):
                        indices = np.concatenate((indices, np.empty_like(indices)))
                    # Rows are short: each column goes to its place at once.
                    place = count
                    while place > indptr[i] and indices[place - 1] > j:
                        indices[place] = indices[place - 1]
                        place -= 1
                    indices[place] = j
                    count += 1
        indptr[i + 1] = count
    return indptr, indices[:count].copy()


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
