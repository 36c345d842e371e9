"""Sparse symmetric systems: assembly into a fixed pattern, and the direct solvers of Intel MKL
PARDISO, in single precision where that is sufficient, or of SciPy."""

import ctypes
import functools
import importlib.metadata
import os
import sys
from collections.abc import Callable
from contextlib import suppress
from typing import Any, Protocol

import numba
import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu


class SparsePattern:
    """Pattern of the upper triangle of symmetric matrices assembled from stencils: the structure in
    CSR, with sorted columns and every diagonal entry. ``stencils`` are (N, K) rows of the matrix
    for each energy, -1 for absent or held; ``slots`` are the places (N, K(K+1)/2) of the upper
    triangles of their blocks, row by row, in the data."""

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
        self.slots = [_slots(stencil, self.indptr, self.indices) for stencil in stencils]

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
def add_blocks(data, slots, blocks):
    """Add symmetric blocks (N, K, K) to the entries ``slots`` (N, K(K+1)/2) of data."""
    for t in range(len(blocks)):
        add_block(data, slots[t], blocks[t])


@numba.njit(inline="always")
def add_block(data, slots, block):
    """Add the upper triangle of a block (K, K) to the entries ``slots`` of data."""
    pair = 0
    for a in range(len(block)):
        for b in range(a, len(block)):
            if slots[pair] >= 0:
                data[slots[pair]] += block[a, b]
            pair += 1


class CholeskySolver(Protocol):
    """Factorises matrices of one pattern, which is analysed once.

    A ``rough`` factor is cheaper: it does not prove definiteness, and its solutions have a relative
    error of about 1e-4 in the matrix's norm. A ``rough`` solution by such a factor may have an
    error of a few per cent, at half the cost.
    """

    def factorise(self, data: np.ndarray, *, rough: bool = False) -> bool:
        """Factor the matrix with CSR data (nnz,); False if not positive definite or finite."""

    def solve(self, rhs: np.ndarray, *, rough: bool = False) -> np.ndarray:
        """Solution (n,) for rhs (n,) with the last factor, which must exist."""


class SuperLUSolver(CholeskySolver):
    """SciPy's SuperLU in symmetric mode: slower, but always available."""

    def __init__(self, pattern: SparsePattern) -> None:
        self._pattern = pattern
        self._factor: Any = None  # of SciPy, without types

    def factorise(self, data: np.ndarray, *, rough: bool = False) -> bool:
        if not np.isfinite(data).all():
            return False
        matrix = sparse.csc_matrix(self._pattern.symmetric(data))
        try:
            self._factor = splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0,
                                options={"SymmetricMode": True})
        except RuntimeError:  # exactly singular
            return False
        # With diagonal pivots, the signs of U's diagonal give the inertia.
        diagonal_pivots = np.array_equal(self._factor.perm_r, self._factor.perm_c)
        return diagonal_pivots and bool((self._factor.U.diagonal() > 0).all())

    def solve(self, rhs: np.ndarray, *, rough: bool = False) -> np.ndarray:
        return self._factor.solve(rhs)


_CHECKS = 1  # number of single-precision failures that are verified in double precision
_TOLERANCE = 1e-2  # of the error before the last refinement, which about squares it
_LENGTH_TOLERANCE = 0.1  # of the optimal scaling of a rough solution, from 1
_MAX_REFINEMENTS = 10
_REPRODUCIBLE = 2  # MKL_CBWR_AUTO; without it, results change if PyTorch is loaded, too


class PardisoSolver(CholeskySolver):
    """Factors in double precision, or rough factors in single precision, which take two thirds of
    the time, with solutions refined by conjugate gradients; two steps nearly always suffice, one
    for a rough solution. The solver switches to double precision for good if the first failure in
    single precision proves wrong, or if a refinement converges too slowly."""

    def __init__(self, pattern: SparsePattern) -> None:
        self._pattern = pattern
        self._factors: dict[bool, PardisoFactor] = {}  # by whether it is in single precision
        self._single_suffices = True
        self._checks = _CHECKS
        self._refined = False

    def factorise(self, data: np.ndarray, *, rough: bool = False) -> bool:
        if not np.isfinite(data).all():
            return False
        rough = rough and self._single_suffices
        self._data = data
        self._refined = rough and self._factor(single=True).factorise(data)
        if self._refined:
            return True
        if rough and self._checks == 0:
            return False
        definite = self._factor().factorise(data)
        if rough:
            self._checks -= 1
            self._single_suffices = not definite
        return definite

    def solve(self, rhs: np.ndarray, *, rough: bool = False) -> np.ndarray:
        return self._refine(rhs, rough) if self._refined else self._factor().solve(rhs)

    def _factor(self, *, single: bool = False) -> "PardisoFactor":
        """The factor of one precision, analysed when it is first needed."""
        if single not in self._factors:
            order = next((factor.order for factor in self._factors.values()), None)
            self._factors[single] = PardisoFactor(self._pattern, order=order, single=single)
        return self._factors[single]

    def _refine(self, rhs: np.ndarray, rough: bool) -> np.ndarray:
        """Conjugate gradients, stopped at a direction of non-positive curvature. A ``rough``
        solution is that of the first step if its optimal scaling is close to 1."""
        x, residual = np.zeros(len(rhs)), np.array(rhs, dtype=np.float64)
        step = self._factor(single=True).solve(residual)
        error = residual @ step
        target = _TOLERANCE**2 * error
        for _ in range(_MAX_REFINEMENTS):
            image = _times(self._data, self._pattern.indices, self._pattern.indptr, step)
            curvature = step @ image
            if not curvature > 0.0:
                break
            length = error / curvature
            x += length * step
            if rough and abs(length - 1.0) < _LENGTH_TOLERANCE:
                return x
            rough = False
            residual -= length * image
            if error <= target:
                return x
            move = self._factor(single=True).solve(residual)
            before, error = error, residual @ move
            step = move + error / before * step
        self._single_suffices = False
        return x


class PardisoFactor:
    """A PARDISO factor in double or ``single`` precision, on one thread, bitwise reproducible;
    ``order`` (n,) is the elimination order of an earlier analysis."""

    _positive_definite = 2  # PARDISO's matrix type
    _analyse, _factorise, _solve, _release = 11, 22, 33, -1  # PARDISO's phases
    _no_memory, _not_definite = -2, -4  # PARDISO's errors

    def __init__(
        self, pattern: SparsePattern, *, order: np.ndarray | None = None, single: bool = False
    ) -> None:
        self._size = pattern.size
        self._indptr, self._indices = pattern.indptr, pattern.indices
        self._dtype = np.float32 if single else np.float64
        self._memory = np.zeros(64, dtype=np.int64)  # PARDISO's addresses
        self._settings = np.zeros(64, dtype=np.int32)
        self._settings[0] = 1  # user settings; all others are zero
        self._settings[1] = 2  # nested dissection; no iterative refinement
        self._settings[4] = 2 if order is None else 1  # return the order, or use the given one
        self._settings[27] = single
        self._settings[34] = 1  # rows and columns count from zero
        self.order = np.zeros(self._size, dtype=np.int32) if order is None else order
        find_mkl().MKL_Set_Num_Threads_Local(1)
        self._data = np.zeros(len(pattern.indices), dtype=self._dtype)
        self._data[pattern.diagonal] = 1.0
        self._require(self._call(self._analyse))

    def factorise(self, data: np.ndarray) -> bool:
        """Factor the matrix with CSR data (nnz,); whether it is positive definite."""
        self._data = np.ascontiguousarray(data, dtype=self._dtype)
        error = self._call(self._factorise)
        if error != self._not_definite:
            self._require(error)
        return error == 0

    def solve(self, rhs: np.ndarray) -> np.ndarray:
        """Solution (n,) float64 for rhs (n,)."""
        rhs = np.ascontiguousarray(rhs, dtype=self._dtype)
        solution = np.empty_like(rhs)
        self._require(self._call(self._solve, rhs, solution))
        return solution.astype(np.float64, copy=False)

    def _call(
        self, phase: int, rhs: np.ndarray | None = None, solution: np.ndarray | None = None
    ) -> int:
        """PARDISO's error code."""
        number = ctypes.c_int32
        error = number(0)
        find_mkl().pardiso(_pointer(self._memory, ctypes.c_int64), number(1), number(1),
                           number(self._positive_definite), number(phase), number(self._size),
                           _pointer(self._data, None), _pointer(self._indptr),
                           _pointer(self._indices), _pointer(self.order), number(1),
                           _pointer(self._settings), number(0), _pointer(rhs, None),
                           _pointer(solution, None), error)
        return error.value

    def _require(self, error: int) -> None:
        """Raise MemoryError or LinAlgError for a PARDISO ``error`` other than 0."""
        if error:
            kind = MemoryError if error == self._no_memory else np.linalg.LinAlgError
            raise kind(f"PARDISO ended with error {error}")

    def __del__(self) -> None:
        if hasattr(self, "_data") and not sys.is_finalizing():
            self._call(self._release)


def _pointer(array: np.ndarray | None, kind: type | None = ctypes.c_int32):
    """Address of an array for C; ``kind`` None for an untyped one."""
    return None if array is None else array.ctypes.data_as(ctypes.POINTER(kind))


@functools.cache
def find_mkl() -> ctypes.CDLL:
    """MKL's library, loaded by pypardiso; its path is set to avoid pypardiso's slow search. Its
    ``pardiso`` is called directly: pypardiso checks, copies and renumbers the matrix at every call.
    """
    if "PYPARDISO_MKL_RT" not in os.environ:
        with suppress(importlib.metadata.PackageNotFoundError):
            for file in importlib.metadata.files("mkl") or []:
                if "mkl_rt" in file.name and not file.name.endswith(".lib"):
                    os.environ["PYPARDISO_MKL_RT"] = str(file.locate())
    from pypardiso import PyPardisoSolver

    library = PyPardisoSolver().libmkl
    if "MKL_CBWR" not in os.environ:
        library.MKL_CBWR_Set(_REPRODUCIBLE)
    return library


@numba.njit(cache=True)
def _times(data, indices, indptr, x):
    """Product (n,) of the symmetric matrix of CSR data (nnz,) and x (n,)."""
    result = np.zeros(len(x))
    for i in range(len(x)):
        total = data[indptr[i]] * x[i]  # the diagonal comes first
        for k in range(indptr[i] + 1, indptr[i + 1]):
            j = indices[k]
            total += data[k] * x[j]
            result[j] += data[k] * x[i]
        result[i] += total
    return result


@functools.cache
def available_solvers() -> tuple[Callable[[SparsePattern], CholeskySolver], ...]:
    """The solvers available on this machine, fastest first."""
    try:
        find_mkl()
    except (ImportError, OSError):
        return (SuperLUSolver,)
    return PardisoSolver, SuperLUSolver


def make_solver(pattern: SparsePattern) -> CholeskySolver:
    """The fastest available solver, for matrices of ``pattern``."""
    return available_solvers()[0](pattern)
