"""Sparse assembly and direct solvers against dense linear algebra."""

import itertools
import os
import subprocess
import sys

import numpy as np
import pytest
from scipy import sparse

from sim.solver.linear import SparsePattern, add_blocks, available_solvers, make_solver


def assembled(pattern: SparsePattern, *blocks: np.ndarray) -> np.ndarray:
    """CSR data of the sum of the blocks (N, K, K) of each stencil."""
    data = np.zeros(len(pattern.indices))
    for slots, block in zip(pattern.slots, blocks, strict=True):
        add_blocks(data, slots, block)
    return data


def chain(count: int = 40, k: int = 3, seed: int = 0):
    """Overlapping stencils, some entries absent, with random symmetric blocks."""
    rng = np.random.default_rng(seed)
    stencil = rng.permuted(np.arange(count)[:, None] + 7 * np.arange(k), axis=1) % count
    stencil[rng.random(stencil.shape) < 0.1] = -1
    half = rng.standard_normal((count, k, k))
    return stencil, half @ np.swapaxes(half, 1, 2)


def dense(stencil: np.ndarray, blocks: np.ndarray, size: int) -> np.ndarray:
    total = np.zeros((size, size))
    for rows, block in zip(stencil, blocks, strict=True):
        for a, i in enumerate(rows):
            for b, j in enumerate(rows):
                if i >= 0 and j >= 0:
                    total[i, j] += block[a, b]
    return total


def test_the_pattern_is_that_of_all_pairs():
    """Elements of different sizes, with rows that none has, against the dense structure."""
    rng = np.random.default_rng(4)
    stencils = [rng.integers(-1, 50, size=(30, 21)), rng.integers(-1, 50, size=(9, 3))]
    pattern = SparsePattern(stencils, 60)
    full = np.eye(60, dtype=bool)
    for rows in itertools.chain(*stencils):
        there = rows[rows >= 0]
        full[np.ix_(there, there)] = True
    expected = sparse.csr_matrix(np.triu(full))
    assert np.array_equal(pattern.indptr, expected.indptr)
    assert np.array_equal(pattern.indices, expected.indices)


def test_assembly_equals_dense_sums():
    (one, first), (two, second) = chain(), chain(k=2, seed=1)
    pattern = SparsePattern([one, two], 40)
    matrix = pattern.symmetric(assembled(pattern, first, second)).toarray()
    assert np.allclose(matrix, dense(one, first, 40) + dense(two, second, 40))
    assert np.array_equal(pattern.indices[pattern.diagonal], np.arange(40))


@pytest.mark.parametrize("kind", available_solvers())
def test_solvers_solve_and_tell_definiteness(kind):
    stencil, blocks = chain()
    pattern = SparsePattern([stencil], 40)
    data = assembled(pattern, blocks)
    data[pattern.diagonal] += 0.1
    matrix = pattern.symmetric(data).toarray()
    solver = kind(pattern)
    rhs = np.random.default_rng(5).standard_normal(40)
    assert solver.factorise(data)
    assert np.allclose(matrix @ solver.solve(rhs), rhs, atol=1e-9)
    lowest = np.linalg.eigvalsh(matrix)[0]
    indefinite = data.copy()
    indefinite[pattern.diagonal] -= 1.01 * lowest
    assert not solver.factorise(indefinite)
    definite = data.copy()
    definite[pattern.diagonal] -= 0.99 * lowest
    assert solver.factorise(definite)  # and a failure leaves the solver usable


def stiff_chain(contrast: float, count: int = 300):
    """Springs whose stiffness grows by ``contrast`` along a chain: pattern and CSR data."""
    stencil = np.arange(count - 1)[:, None] + np.arange(2)
    pattern = SparsePattern([stencil], count)
    stiffness = contrast ** np.linspace(0, 1, count - 1)
    data = assembled(pattern, stiffness[:, None, None] * np.array([[1.0, -1.0], [-1.0, 1.0]]))
    data[pattern.diagonal[0]] += 1.0
    return pattern, data


def error_in_norm(pattern, data, solver, **settings) -> float:
    """Relative error of a solution, in the norm of the matrix."""
    matrix = pattern.symmetric(data)
    exact = np.random.default_rng(0).standard_normal(pattern.size)
    wrong = solver.solve(matrix @ exact, **settings) - exact
    return float(np.sqrt((wrong @ (matrix @ wrong)) / (exact @ (matrix @ exact))))


@pytest.mark.parametrize("kind", available_solvers())
@pytest.mark.parametrize("contrast", [1e2, 1e6, 1e8])
def test_rough_factors_serve_rough_and_refined_solutions(kind, contrast):
    """Also where single precision is no good at all, which the solver finds out by itself."""
    pattern, data = stiff_chain(contrast)
    solver = kind(pattern)
    assert solver.factorise(data, rough=True)
    assert error_in_norm(pattern, data, solver, rough=True) < 0.1
    assert error_in_norm(pattern, data, solver) < 1e-4
    if contrast < 1e8:
        assert solver.factorise(data)  # after a rough factor, an exact one is exact
        assert error_in_norm(pattern, data, solver) < 1e-10


@pytest.mark.parametrize("kind", available_solvers())
def test_rough_verdicts_on_matrices_that_single_precision_cannot_tell(kind):
    """Hilbert's matrix of order 10: definite in double precision, not in single."""
    hilbert = 1.0 / (1.0 + np.arange(10)[:, None] + np.arange(10))
    with pytest.raises(np.linalg.LinAlgError):
        np.linalg.cholesky(hilbert.astype(np.float32))
    pattern = SparsePattern([np.arange(10)[None]], 10)
    data = assembled(pattern, hilbert[None])
    solver = kind(pattern)
    for _ in range(5):
        assert solver.factorise(data, rough=True)
        assert error_in_norm(pattern, data, solver) < 1e-4
    data[pattern.diagonal] -= 2 * np.linalg.eigvalsh(hilbert)[0]
    assert not solver.factorise(data, rough=True)


def test_rough_verdicts_on_indefinite_matrices_stay_right():
    pattern, data = stiff_chain(10.0)
    solver = make_solver(pattern)
    indefinite = data.copy()
    indefinite[pattern.diagonal[150]] *= -1
    for _ in range(5):  # more often than failures are checked
        assert not solver.factorise(indefinite, rough=True)
        assert solver.factorise(data, rough=True)
        assert error_in_norm(pattern, data, solver) < 1e-4


@pytest.mark.parametrize("rough", [False, True])
def test_solutions_do_not_depend_on_where_the_numbers_lie(rough):
    pattern, data = stiff_chain(1e4, count=2000)
    rhs = np.random.default_rng(3).standard_normal(pattern.size)
    results = set()
    for offset in range(8):  # of 8 bytes
        aligned = np.empty(len(data) + 8)[offset : offset + len(data)]
        right = np.empty(len(rhs) + 8)[7 - offset : 7 - offset + len(rhs)]
        aligned[:], right[:] = data, rhs
        solver = make_solver(pattern)
        assert solver.factorise(aligned, rough=rough)
        results.add(solver.solve(right).tobytes())
    assert len(results) == 1


def test_solutions_do_not_depend_on_libraries_loaded_before():
    """PyTorch brings another MKL, which may change the paths that this one takes."""
    script = """
import hashlib, sys
{first}
import numpy as np
from sim.solver.linear import SparsePattern, add_blocks, make_solver
grid = np.arange(900).reshape(30, 30)
cells = np.stack([grid[:-1, :-1], grid[1:, :-1], grid[:-1, 1:], grid[1:, 1:]], -1).reshape(-1, 4)
stencil = (3 * cells[:, :, None] + np.arange(3)).reshape(-1, 12)
half = np.random.default_rng(0).standard_normal((len(stencil), 12, 12))
pattern = SparsePattern([stencil], 2700)
data = np.zeros(len(pattern.indices))
add_blocks(data, pattern.slots[0], half @ np.swapaxes(half, 1, 2))
solver = make_solver(pattern)
for rough in (False, True):
    assert solver.factorise(data, rough=rough)
    print(hashlib.sha1(solver.solve(np.ones(2700)).tobytes()).hexdigest())
"""
    found = {
        subprocess.run(
            [sys.executable, "-c", script.format(first=first)],
            capture_output=True, text=True, check=True, env={**os.environ, "OMP_NUM_THREADS": "1"},
        ).stdout
        for first in ("", "import torch")
    }
    assert len(found) == 1
