"""Least squares of few unknowns by Levenberg-Marquardt, every evaluation a simulation.

A failed simulation is a rejected step.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from typing import Protocol

import numpy as np
from scipy.optimize import brentq

MAX_STEP = 1.0  # in a problem's units; the linearisation of a drape is not valid beyond


class LeastSquares(Protocol):
    """A least-squares problem in bounded unknowns x (n,), scaled so that 1 is a typical step."""

    start: np.ndarray
    low: np.ndarray
    high: np.ndarray

    def value(self, x: np.ndarray) -> float:
        """Half the sum of squares at ``x``; infinite if it does not exist."""

    def linearised(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        """Residuals (N,) and their derivatives (N, n) at the last or best point with a finite
        :meth:`value`; None if there are no derivatives."""


class Status(str, Enum):
    """How an optimisation ended."""

    CONVERGED = "converged"
    STALLED = "stalled"  # no step decreases the value, although the model predicts it
    EXHAUSTED = "exhausted"  # limit of evaluations
    FAILED = "failed"  # the start has no value or no derivatives


@dataclass(frozen=True)
class Limits:
    """Stopping criteria."""

    evaluations: int = 25  # maximum number of simulations
    step: float = 1e-3  # minimum step, in the problem's units
    decrease: float = 1e-4  # minimum predicted decrease of a step, relative to the value


@dataclass
class Outcome:
    """The best point x (n,), its value, the evaluations made, and how the search ended."""

    x: np.ndarray
    value: float = math.inf
    evaluations: int = 0
    status: Status = Status.FAILED
    message: str = "the start cannot be simulated"


def minimise(
    problem: LeastSquares, *, limits: Limits | None = None,
    report: Callable[[], object] | None = None,
) -> Outcome:
    """Minimise ``problem``; ``report`` is called after every evaluation."""
    outcome = Outcome(np.clip(problem.start, problem.low, problem.high))

    def value(x: np.ndarray) -> float:
        """The value at x, counted; the best is kept."""
        at_x = float(problem.value(x))
        at_x = at_x if math.isfinite(at_x) else math.inf
        outcome.evaluations += 1
        if at_x < outcome.value:
            outcome.x, outcome.value = x, at_x
        if report:
            report()
        return at_x

    if math.isfinite(value(outcome.x)):
        outcome.status, outcome.message = _descend(problem, outcome, value, limits or Limits())
    return outcome


def _descend(
    problem: LeastSquares, best: Outcome, value: Callable[[np.ndarray], float], limits: Limits
) -> tuple[Status, str]:
    """Gauss-Newton with a trust region, which keeps unknowns of low sensitivity, and active bounds,
    from the ``best`` point, which ``value`` updates.
    """
    radius, moved = 0.5 * MAX_STEP, False
    while True:
        x, before = best.x, best.value
        linearised = problem.linearised(x)
        if linearised is None:
            return (Status.STALLED if moved else Status.FAILED), "the drape has no derivatives here"
        residuals, jacobian = linearised
        gradient = jacobian.T @ residuals
        curvature = jacobian.T @ jacobian
        at_bound = ((x <= problem.low) & (gradient > 0)) | ((x >= problem.high) & (gradient < 0))
        free = np.flatnonzero(~at_bound)
        while best.value == before:
            step = np.zeros(len(x))
            step[free] = _step_within(gradient[free], curvature[np.ix_(free, free)], radius)
            full_step = np.linalg.norm(step) < 0.99 * radius
            step = np.clip(x + step, problem.low, problem.high) - x
            length = float(np.linalg.norm(step))
            promised = -(gradient @ step + 0.5 * step @ curvature @ step)
            if length < limits.step or promised < limits.decrease * before:
                # A full step means convergence; otherwise the radius has become too small.
                return ((Status.CONVERGED, "no step is worth taking") if full_step
                        else (Status.STALLED, "no step leads down"))
            if best.evaluations >= limits.evaluations:
                return Status.EXHAUSTED, f"{best.evaluations} simulations, as many as allowed"
            gain = (before - value(x + step)) / promised
            if gain > 0.75 and not full_step:
                radius = min(2 * radius, MAX_STEP)
            elif gain < 0.25:
                radius = 0.3 * length
        moved = True


def _step_within(gradient: np.ndarray, curvature: np.ndarray, radius: float) -> np.ndarray:
    """The step (n,) that minimises the quadratic, no longer than ``radius``."""
    if not len(gradient):
        return np.zeros(0)
    values, vectors = np.linalg.eigh(curvature)
    # Unidentifiable directions get no step.
    values = np.maximum(values, 1e-12 * max(values[-1], 1e-300))
    slopes = vectors.T @ gradient

    def step(damping: float) -> np.ndarray:
        return -vectors @ (slopes / (values + damping))

    def excess(log_damping: float) -> float:
        return float(np.linalg.norm(step(math.exp(log_damping)))) - radius

    length = float(np.linalg.norm(step(0.0)))
    if length <= radius:
        return step(0.0)
    low = math.log(values[0]) - 40
    high = math.log(max(np.linalg.norm(gradient) / radius, values[0])) + 1
    return step(math.exp(brentq(excess, low, high, xtol=1e-3)))
