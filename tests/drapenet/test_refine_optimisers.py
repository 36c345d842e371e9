"""Optimisers on problems whose answers are known."""

import math

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from drapenet.refine.minimise import Limits, Status, minimise
from experiments.papers.optimisers import METHODS

DERIVATIVES = ("lm", "lbfgs")


class Linear:
    """Residuals A x - b between bounds."""

    def __init__(self, matrix: np.ndarray, target: np.ndarray, start: np.ndarray) -> None:
        self.matrix, self.target, self.start = matrix, target, start
        self.low, self.high = np.full(len(start), -2.0), np.full(len(start), 2.0)
        self.asked = 0

    def value(self, x: np.ndarray) -> float:
        self.asked += 1
        residuals = self.matrix @ x - self.target
        return 0.5 * float(residuals @ residuals)

    def linearised(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return self.matrix @ x - self.target, self.matrix


class Valley(Linear):
    """Rosenbrock's function."""

    def __init__(self) -> None:
        super().__init__(np.eye(2), np.zeros(2), np.array([-1.2, 1.0]))

    def value(self, x: np.ndarray) -> float:
        self.asked += 1
        residuals, _ = self.linearised(x)
        return 0.5 * float(residuals @ residuals)

    def linearised(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return (np.array([10 * (x[1] - x[0] ** 2), 1 - x[0]]),
                np.array([[-20 * x[0], 10.0], [-1.0, 0.0]]))


def linear(seed: int, spread: float = 1.0) -> Linear:
    rng = np.random.default_rng(seed)
    return Linear(rng.standard_normal((9, 4)) * spread ** np.arange(4), rng.standard_normal(9) * 4,
                  rng.uniform(-1, 1, 4))


@pytest.mark.parametrize("method", DERIVATIVES)
@pytest.mark.parametrize("seed", range(3))
def test_bounded_linear_problems_are_solved(method: str, seed: int) -> None:
    problem = linear(seed)
    expected = lsq_linear(problem.matrix, problem.target, (-2, 2))
    found = minimise(problem, method=METHODS[method],
                     limits=Limits(evaluations=200, step=1e-9, decrease=1e-12))
    assert found.value == pytest.approx(expected.cost, rel=1e-6)
    assert np.abs(found.x - expected.x).max() < 1e-3


@pytest.mark.parametrize(("method", "most"), [("lm", 40), ("lbfgs", 90), ("cmaes", 1200)])
def test_a_bent_valley_is_followed_to_its_end(method: str, most: int) -> None:
    problem = Valley()
    found = minimise(problem, method=METHODS[method],
                     limits=Limits(evaluations=2000, step=1e-8, decrease=1e-12))
    assert np.abs(found.x - 1).max() < 1e-2
    assert found.evaluations == problem.asked <= most
    assert found.status is Status.CONVERGED


def test_damping_keeps_what_nothing_depends_on() -> None:
    problem = linear(0)
    problem.matrix[:, 2] = 0.0
    found = minimise(problem, method=METHODS["lm"], limits=Limits(evaluations=50, step=1e-9))
    assert found.x[2] == pytest.approx(problem.start[2], abs=1e-6)
    assert found.status is Status.CONVERGED


@pytest.mark.parametrize("method", METHODS)
def test_walls_of_failed_simulations_are_rejected_steps(method: str) -> None:
    class Walled(Valley):
        def value(self, x: np.ndarray) -> float:
            plain = super().value(x)
            return plain if x[0] < 0.3 else math.inf

    found = minimise(Walled(), method=METHODS[method], limits=Limits(evaluations=120))
    start = 0.5 * (4.4**2 + 2.2**2)
    assert found.value < 0.5 * start
    assert found.x[0] < 0.3


@pytest.mark.parametrize("method", METHODS)
def test_never_worse_than_the_start_whatever_the_derivatives_say(method: str) -> None:
    class Liar(Valley):
        def linearised(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            residuals, jacobian = super().linearised(x)
            return residuals, -jacobian

    problem = Liar()
    found = minimise(problem, method=METHODS[method], limits=Limits(evaluations=30))
    assert found.value <= problem.value(problem.start)
    assert all(later.value < earlier.value
               for earlier, later in zip(found.trace[:-1], found.trace[1:], strict=True))


@pytest.mark.parametrize("method", METHODS)
def test_no_more_simulations_than_allowed(method: str) -> None:
    problem = Valley()
    found = minimise(problem, method=METHODS[method],
                     limits=Limits(evaluations=7, step=1e-12, decrease=1e-15))
    assert problem.asked <= 7
    assert found.status is Status.EXHAUSTED


def test_a_start_without_a_value_is_reported() -> None:
    class Nowhere(Valley):
        def value(self, x: np.ndarray) -> float:
            return math.inf

    found = minimise(Nowhere())
    assert found.status is Status.FAILED and found.value == math.inf
