"""Sparse assembly and direct solvers against dense linear algebra."""

import numpy as np
import pytest

from sim.errors import InputError
from sim.linear import SparsePattern, available_solvers, make_solver


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


def test_assembly_equals_dense_sums():
    (one, first), (two, second) = chain(), chain(k=2, seed=1)
    pattern = SparsePattern([one, two], 40)
    matrix = pattern.symmetric(pattern.assemble([first, second])).toarray()
    assert np.allclose(matrix, dense(one, first, 40) + dense(two, second, 40))
    assert np.array_equal(pattern.indices[pattern.diagonal], np.arange(40))


@pytest.mark.parametrize("name", available_solvers())
def test_solvers_solve_and_tell_definiteness(name):
    stencil, blocks = chain()
    pattern = SparsePattern([stencil], 40)
    data = pattern.assemble([blocks])
    data[pattern.diagonal] += 0.1
    matrix = pattern.symmetric(data).toarray()
    solver = make_solver(pattern, name)
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


def test_unknown_solver_is_refused():
    with pytest.raises(InputError, match="magic"):
        make_solver(SparsePattern([np.array([[0, 1]])], 2), "magic")
