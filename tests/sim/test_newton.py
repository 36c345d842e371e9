"""Newton's method and its linear solvers."""

import itertools
import os
import subprocess
import sys
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import sparse

from sim.solver.linear import SparsePattern, add_blocks, available_solvers, make_solver
from sim.solver.newton import NewtonOptions, Status, minimise


class Function:
    """An objective of two unknowns from its value, gradient and Hessian."""

    size = 2
    pattern = SparsePattern([np.array([[0, 1]])], 2)
    energy_scale = 1.0

    def __init__(self, value, gradient, hessian):
        self.value, self.gradient, self._hessian = value, gradient, hessian

    def evaluate(self, y):
        return self.value(y), self.gradient(y)

    def model(self, y):
        return SimpleNamespace(hessian=partial(self.hessian, y))

    def hessian(self, y, convexity, shift):

        value, vector = np.linalg.eigh(np.array(self._hessian(y)))
        blended = np.where(value > 0, value, (1 - convexity) * value)
        matrix = (vector * blended) @ vector.T + shift * np.eye(2)
        return matrix[np.triu_indices(2)]

    def moved(self, y, step):
        return y + step

    def allows(self, old, new):
        return True

    def residual(self, gradient):
        return float(np.abs(gradient).max())

    step_length = residual


def rosenbrock() -> Function:
    return Function(
        lambda y: (1 - y[0]) ** 2 + 100 * (y[1] - y[0] ** 2) ** 2,
        lambda y: np.array([-2 * (1 - y[0]) - 400 * y[0] * (y[1] - y[0] ** 2),
                            200 * (y[1] - y[0] ** 2)]),
        lambda y: [[2 - 400 * (y[1] - 3 * y[0] ** 2), -400 * y[0]], [-400 * y[0], 200]],
    )


def double_well(at: float = 1.0, slope: float = 1.0) -> Function:
    """Minima at y0 = ±at, y1 = 0, and a saddle at the origin, of the curvature -slope."""
    return Function(
        lambda y: slope * y[0] ** 2 * ((y[0] / at) ** 2 / 4 - 1 / 2) + y[1] ** 2,
        lambda y: np.array([slope * y[0] * ((y[0] / at) ** 2 - 1), 2 * y[1]]),
        lambda y: [[slope * (3 * (y[0] / at) ** 2 - 1), 0], [0, 2]],
    )


def constant(value: float, slope: float, curvature: float) -> Function:
    return Function(lambda y: value, lambda y: np.full(2, slope),
                    lambda y: [[curvature, 0], [0, 1]])


@pytest.mark.parametrize("start", [(-1.2, 1.0), (3.0, -4.0), (0.0, 5.0)])
def test_rosenbrock_in_few_iterations(start):
    result = minimise(rosenbrock(), np.array(start), NewtonOptions(residual=1e-10, step=1e-8))
    assert result.status is Status.CONVERGED and result.positive_definite
    assert np.allclose(result.q, 1, atol=1e-8)
    assert result.iterations < 40
    rhs = np.array([1.0, 2.0])  # the factor that proves the minimum is that of its Hessian
    assert np.allclose(np.array([[802, -400], [-400, 200]]) @ result.factor.solve(rhs), rhs)


def test_the_zero_of_the_energy_does_not_matter():
    """Steps that change a large energy by little are not taken for rounding."""
    plain, raised = rosenbrock(), rosenbrock()
    raised.value = lambda y: rosenbrock().value(y) + 1e6
    options = NewtonOptions(residual=1e-7, step=1e-7)
    one, other = (minimise(f, np.array([-1.2, 1.0]), options) for f in (plain, raised))
    assert one.status is other.status is Status.CONVERGED
    assert np.allclose(one.q, other.q, atol=1e-6)


def test_states_need_not_form_a_linear_space():
    """The least height on a sphere: states are unit vectors, steps are tangent."""

    class Height:
        size, pattern, energy_scale = 2, Function.pattern, 1.0
        allows = Function.allows
        residual = step_length = Function.residual
        evaluate, model = Function.evaluate, Function.model

        def frame(self, q):
            first = np.cross(q, [0.6, 0.0, 0.8])
            first /= np.linalg.norm(first)
            return np.stack([first, np.cross(q, first)])

        def value(self, q):
            return float(q[2])

        def gradient(self, q):
            return self.frame(q)[:, 2]

        def hessian(self, q, convexity, shift):
            return max(-q[2], convexity * abs(q[2])) * np.array([1.0, 0.0, 1.0])

        def moved(self, q, step):
            move = step @ self.frame(q)
            angle = np.linalg.norm(move)
            return np.cos(angle) * q + np.sinc(angle / np.pi) * move

    result = minimise(Height(), np.array([0.0, 0.6, 0.8]))
    assert result.status is Status.CONVERGED
    assert np.allclose(result.q, [0, 0, -1], atol=1e-4)


def test_end_is_quadratic():
    """From close by, every exact Newton step squares the residual."""
    residuals = [
        minimise(double_well(), np.array([1.05, 0.02]),
                 NewtonOptions(residual=1e-14, step=1e-12, max_iterations=most)).residual
        for most in range(1, 12)]
    falling = [r for r in dict.fromkeys(residuals) if 1e-13 < r < 1e-2]
    assert len(falling) >= 2
    assert all(after < 10 * before**2 for before, after in itertools.pairwise(falling))


@pytest.mark.parametrize(("well", "options", "tolerance"), [
    ((1.0, 1.0), {}, 1e-4),
    # Nearer to the saddle than 1 the residual is below what is asked.
    ((9.0, 1e-5), {"residual": 1e-5, "step": 1e-3}, 1e-3)])
def test_saddles_are_left_and_flat_ones_too(well, options, tolerance):
    result = minimise(double_well(*well), np.zeros(2), NewtonOptions(**options))
    assert result.status is Status.CONVERGED
    assert abs(result.q[0]) == pytest.approx(well[0], abs=tolerance)


def test_a_minimum_is_proved_in_full_precision(monkeypatch):
    calls, solved = [], []

    def recording(pattern):
        solver = make_solver(pattern)
        factorise = solver.factorise
        solver.factorise = lambda data, *, rough=False: calls.append(rough) or factorise(
            data, rough=rough)
        solve = solver.solve
        solver.solve = lambda rhs, *, rough=False: solved.append(rough) or solve(rhs, rough=rough)
        return solver

    monkeypatch.setattr("sim.solver.newton.make_solver", recording)
    result = minimise(rosenbrock(), np.array([-1.2, 1.0]))
    assert result.positive_definite
    assert not calls[-1] and all(calls[:3])  # proved exactly, found roughly
    assert solved[0] and not any(solved[-3:])  # far away, rough steps do


def test_a_model_that_points_out_of_range_is_made_stiffer():
    """sqrt(y0² + 1e-12) + y1²: far from its minimum all but straight, Newton's step is 1e15."""
    nearly_flat_roof = Function(
        lambda y: np.sqrt(y[0] ** 2 + 1e-12) + y[1] ** 2,
        lambda y: np.array([y[0] / np.sqrt(y[0] ** 2 + 1e-12), 2 * y[1]]),
        lambda y: [[1e-12 / (y[0] ** 2 + 1e-12) ** 1.5, 0], [0, 2]],
    )
    result = minimise(nearly_flat_roof, np.array([10.0, 1.0]),
                      NewtonOptions(residual=1e-6, step=1e-6, max_iterations=60))
    assert result.status is Status.CONVERGED
    assert np.abs(result.q).max() < 1e-6


@pytest.mark.parametrize(("function", "start", "options", "status", "most"), [
    # Every step is refused, far from the minimum and next to it.
    (rosenbrock, (3.0, 1.0), {"residual": 3.0, "step": 1e-8}, Status.LINE_SEARCH, 9),
    (rosenbrock, (0.0, 0.0), {"residual": 3.0, "step": 1e-8}, Status.LINE_SEARCH, 9),
    (rosenbrock, (-1.2, 1.0), {"max_iterations": 3}, Status.MAX_ITERATIONS, 3),
    (partial(constant, np.nan, np.nan, 1.0), (0.0, 0.0), {}, Status.NOT_FINITE, 200),
    # A saddle that perturbations do not leave
    (partial(constant, 0.0, 0.0, -1.0), (0.0, 0.0), {}, Status.SADDLE, 200)])
def test_failures_are_reported(function, start, options, status, most):
    failing = function()
    if status is Status.LINE_SEARCH:
        failing.allows = lambda old, new: False
    result = minimise(failing, np.array(start), NewtonOptions(**options))
    assert result.status is status and result.iterations <= most
    assert status is not Status.SADDLE or not result.positive_definite
    if status is Status.MAX_ITERATIONS:
        assert result.iterations == 3 and "3 iterations" in result.message


def test_forbidden_steps_are_shortened():
    function = rosenbrock()
    longest = []

    def allows(old, new):
        longest.append(np.abs(new - old).max())
        return longest[-1] < 0.1

    function.allows = allows
    result = minimise(function, np.array([-1.2, 1.0]))
    assert result.status is Status.CONVERGED and max(longest) > 0.1
    assert np.allclose(result.q, 1, atol=1e-4)


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


def test_pattern_and_assembly_equal_dense_sums():
    """Of elements of different sizes, with rows that none has."""
    elements = chain(), chain(k=2, seed=1)
    pattern = SparsePattern([stencil for stencil, _ in elements], 45)
    total, coupled = np.zeros((45, 45)), np.eye(45, dtype=bool)
    for rows, block in itertools.chain(*(zip(*element, strict=True) for element in elements)):
        at = np.ix_(rows[rows >= 0], rows[rows >= 0])
        total[at] += block[np.ix_(rows >= 0, rows >= 0)]
        coupled[at] = True
    matrix = pattern.symmetric(assembled(pattern, *(blocks for _, blocks in elements))).toarray()
    assert np.allclose(matrix, total)
    expected = sparse.csr_matrix(np.triu(coupled))
    assert np.array_equal(pattern.indptr, expected.indptr)
    assert np.array_equal(pattern.indices, expected.indices)
    assert np.array_equal(pattern.indices[pattern.diagonal], np.arange(45))


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
def test_rough_verdicts_are_right(kind):
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
    # Those that it can tell, more often than failures are checked
    pattern, definite = stiff_chain(10.0)
    solver, indefinite = kind(pattern), definite.copy()
    indefinite[pattern.diagonal[150]] *= -1
    for _ in range(5):
        assert not solver.factorise(indefinite, rough=True)
        assert solver.factorise(definite, rough=True)
        assert error_in_norm(pattern, definite, solver) < 1e-4


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
