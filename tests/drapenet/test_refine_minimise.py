"""Levenberg-Marquardt on problems whose answers are known."""

import math
from functools import partial

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from drapenet.refine.minimise import Limits, Status, minimise


class Linear:
    """Residuals A x - b between bounds."""

    def __init__(self, matrix: np.ndarray, target: np.ndarray, start: np.ndarray) -> None:
        self.matrix, self.target, self.start = matrix, target, start
        self.low, self.high = np.full(len(start), -2.0), np.full(len(start), 2.0)
        self.evaluations = 0

    def value(self, x: np.ndarray) -> float:
        self.evaluations += 1
        residuals, _ = self.linearised(x)
        return 0.5 * float(residuals @ residuals)

    def linearised(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return self.matrix @ x - self.target, self.matrix


class Valley(Linear):
    """Rosenbrock's function, without a value beyond a wall."""

    def __init__(self, wall: float = math.inf) -> None:
        super().__init__(np.eye(2), np.zeros(2), np.array([-1.2, 1.0]))
        self.wall = wall

    def value(self, x: np.ndarray) -> float:
        value = super().value(x)
        return value if x[0] < self.wall else math.inf

    def linearised(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return (np.array([10 * (x[1] - x[0] ** 2), 1 - x[0]]),
                np.array([[-20 * x[0], 10.0], [-1.0, 0.0]]))


START_VALUE = 0.5 * (4.4**2 + 2.2**2)


def linear(seed: int) -> Linear:
    rng = np.random.default_rng(seed)
    return Linear(rng.standard_normal((9, 4)), rng.standard_normal(9) * 4, rng.uniform(-1, 1, 4))


@pytest.mark.parametrize("seed", range(3))
def test_bounded_linear_problems_are_solved(seed):
    problem = linear(seed)
    expected = lsq_linear(problem.matrix, problem.target, (-2, 2))
    outcome = minimise(problem, limits=Limits(evaluations=200, step=1e-9, decrease=1e-12))
    assert outcome.value == pytest.approx(expected.cost, rel=1e-6)
    assert np.abs(outcome.x - expected.x).max() < 1e-3


def test_a_bent_valley_is_followed_to_its_end():
    problem = Valley()
    outcome = minimise(problem, limits=Limits(2000, step=1e-8, decrease=1e-12))
    assert outcome.status is Status.CONVERGED
    assert outcome.evaluations == problem.evaluations <= 40
    assert np.abs(outcome.x - 1).max() < 1e-2 and outcome.value < 1e-6


def test_a_wall_of_failed_simulations_is_not_passed():
    problem = Valley(wall=0.3)
    outcome = minimise(problem, limits=Limits(120))
    assert problem.evaluations <= 120
    assert outcome.value < 0.5 * START_VALUE and outcome.x[0] < 0.3


def test_what_nothing_depends_on_keeps_its_value():
    problem = linear(0)
    problem.matrix[:, 2] = 0.0
    outcome = minimise(problem, limits=Limits(evaluations=50, step=1e-9))
    assert outcome.x[2] == pytest.approx(problem.start[2], abs=1e-6)
    assert outcome.status is Status.CONVERGED


def test_the_limit_is_kept_and_every_evaluation_reported():
    problem, reports = Valley(), []
    outcome = minimise(problem, limits=Limits(7, step=1e-12, decrease=1e-15),
                       report=partial(reports.append, None))
    assert problem.evaluations == outcome.evaluations == len(reports) == 7
    assert outcome.status is Status.EXHAUSTED


def test_the_result_is_never_worse_than_the_start():
    class Wrong(Valley):
        def linearised(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            residuals, jacobian = super().linearised(x)
            return residuals, -jacobian

    outcome = minimise(Wrong(), limits=Limits(30))
    assert outcome.value <= START_VALUE and outcome.status is Status.STALLED


def test_a_start_without_a_value_is_reported():
    outcome = minimise(Valley(wall=-2.0))
    assert outcome.status is Status.FAILED and outcome.value == math.inf
