"""Direct solvers for sparse symmetric matrices with a test of positive definiteness."""

import functools
from typing import Protocol

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from common.errors import InputError
from sim.solver.linear.pardiso import PardisoSolver, find_mkl
from sim.solver.linear.pattern import SparsePattern


class CholeskySolver(Protocol):
    """Factorises matrices of one pattern, which is analysed once.

    A ``rough`` factor is cheaper: it does not prove definiteness, and its solutions have a relative
    error of about 1e-4 in the matrix's norm. A ``rough`` solution by such a factor may have an
    error of a few per cent, at half the cost.
    """

    name: str

    def factorise(self, data: np.ndarray, *, rough: bool = False) -> bool:
        """Factor the matrix with CSR data (nnz,); False if not positive definite or finite."""

    def solve(self, rhs: np.ndarray, *, rough: bool = False) -> np.ndarray:
        """Solution (n,) for rhs (n,) with the last factor, which must exist."""


class SuperLUSolver:
    """SciPy's SuperLU in symmetric mode: slower, but always available."""

    name = "superlu"

    def __init__(self, pattern: SparsePattern) -> None:
        self._pattern = pattern
        self._factor = None

    def factorise(self, data: np.ndarray, *, rough: bool = False) -> bool:
        """See :meth:`sim.solver.linear.solvers.CholeskySolver.factorise`."""
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
        """See :meth:`sim.solver.linear.solvers.CholeskySolver.solve`."""
        return self._factor.solve(rhs)


_SOLVERS = {solver.name: solver for solver in (PardisoSolver, SuperLUSolver)}


@functools.cache
def available_solvers() -> tuple[str, ...]:
    """Names of the solvers available on this machine, fastest first."""
    try:
        find_mkl()
    except (ImportError, OSError):
        return (SuperLUSolver.name,)
    return tuple(_SOLVERS)


def make_solver(pattern: SparsePattern, name: str | None = None) -> CholeskySolver:
    """The solver called ``name``, or the fastest, for matrices of ``pattern``; InputError for an
    unknown or unavailable name."""
    available = available_solvers()
    name = name or available[0]
    if name not in available:
        raise InputError(f"linear solver '{name}' is not available here; choose {available}")
    return _SOLVERS[name](pattern)
