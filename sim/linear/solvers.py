"""Direct solvers for sparse symmetric matrices that say whether the matrix is positive definite."""

import functools
import importlib.metadata
import os
import sys
from typing import Protocol

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from sim.errors import InputError
from sim.linear.pattern import SparsePattern


class CholeskySolver(Protocol):
    """Factorises matrices of one pattern; the analysis of the pattern is done once."""

    name: str

    def factorise(self, data: np.ndarray) -> bool:
        """Factor the matrix with CSR data (nnz,); False when it is not positive definite."""

    def solve(self, rhs: np.ndarray) -> np.ndarray:
        """Solve with the last factor, which must exist; rhs (n,) or (n, k)."""


class PardisoSolver:
    """Cholesky factorisation by Intel MKL PARDISO, on one thread, reproducible to the bit."""

    name = "pardiso"
    _positive_definite = 2  # PARDISO's matrix type
    _analyse, _factorise, _solve = 11, 22, 33  # PARDISO's phases
    _reproducible = 2  # MKL_CBWR_AUTO: results do not depend on memory alignment

    def __init__(self, pattern: SparsePattern) -> None:
        self._pardiso = _pardiso(self._positive_definite)
        self._pardiso.set_iparm(1, 1)  # the settings below are ours, the others zero:
        self._pardiso.set_iparm(2, 2)  # nested dissection; no iterative refinement
        self._pardiso.libmkl.MKL_CBWR_Set(self._reproducible)
        self._pardiso.libmkl.MKL_Set_Num_Threads_Local(1)
        self._empty = np.zeros((pattern.size, 1))
        self._matrix = pattern.upper(np.zeros(len(pattern.indices)))
        self._matrix.data[pattern.diagonal] = 1.0
        self._call(self._analyse, self._empty)

    def factorise(self, data: np.ndarray) -> bool:
        from pypardiso.pardiso_wrapper import PyPardisoError

        self._matrix.data[:] = data
        try:
            self._call(self._factorise, self._empty)
        except PyPardisoError as error:
            if error.value == -4:  # a pivot was not positive
                return False
            raise
        return True

    def solve(self, rhs: np.ndarray) -> np.ndarray:
        return self._call(self._solve, np.asfortranarray(rhs))

    def _call(self, phase: int, rhs: np.ndarray) -> np.ndarray:
        self._pardiso.set_phase(phase)
        return self._pardiso._call_pardiso(self._matrix, rhs)

    def __del__(self) -> None:
        if hasattr(self, "_pardiso") and not sys.is_finalizing():
            self._pardiso.free_memory(everything=True)


class SuperLUSolver:
    """SciPy's SuperLU in symmetric mode: slower, but present wherever SciPy is."""

    name = "superlu"

    def __init__(self, pattern: SparsePattern) -> None:
        self._pattern = pattern
        self._factor = None

    def factorise(self, data: np.ndarray) -> bool:
        matrix = sparse.csc_matrix(self._pattern.symmetric(data))
        try:
            self._factor = splu(
                matrix,
                permc_spec="MMD_AT_PLUS_A",
                diag_pivot_thresh=0.0,
                options={"SymmetricMode": True},
            )
        except RuntimeError:  # exactly singular
            return False
        # With diagonal pivots, U's diagonal holds the pivots, and their signs the inertia.
        diagonal_pivots = np.array_equal(self._factor.perm_r, self._factor.perm_c)
        return diagonal_pivots and bool((self._factor.U.diagonal() > 0).all())

    def solve(self, rhs: np.ndarray) -> np.ndarray:
        return self._factor.solve(rhs)


_SOLVERS = {solver.name: solver for solver in (PardisoSolver, SuperLUSolver)}


def _pardiso(matrix_type: int):
    """A new pypardiso solver, whose slow search of the disk for MKL we spare ourselves."""
    if "PYPARDISO_MKL_RT" not in os.environ:
        try:
            files = importlib.metadata.files("mkl") or []
        except importlib.metadata.PackageNotFoundError:
            files = []
        for file in files:
            if "mkl_rt" in file.name and not file.name.endswith(".lib"):
                os.environ["PYPARDISO_MKL_RT"] = str(file.locate())
                break
    from pypardiso import PyPardisoSolver

    return PyPardisoSolver(mtype=matrix_type)


@functools.cache
def available_solvers() -> tuple[str, ...]:
    """Names of the solvers that work here, fastest first."""
    try:
        _pardiso(PardisoSolver._positive_definite)
    except (ImportError, OSError):
        return (SuperLUSolver.name,)
    return tuple(_SOLVERS)


def make_solver(pattern: SparsePattern, name: str | None = None) -> CholeskySolver:
    """The solver called ``name``, or the fastest available one, for matrices of ``pattern``.

    Raises:
        InputError: unknown or unavailable name.
    """
    available = available_solvers()
    if name is None:
        name = available[0]
    if name not in available:
        raise InputError(f"linear solver '{name}' is not available here; choose {available}")
    return _SOLVERS[name](pattern)
