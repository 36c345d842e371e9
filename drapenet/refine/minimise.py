"""Least squares of few unknowns, every evaluation a simulation.

    outcome = minimise(problem, limits=Limits(evaluations=25))

Levenberg-Marquardt, or another :data:`Method` for comparison. All respect bounds, treat a failed
simulation as a rejected step, and return the best evaluated point, also when interrupted.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum
from typing import Protocol

import numpy as np
from scipy.optimize import brentq

MAX_STEP = 1.0
"""Maximum step, in a problem's units: the linearisation of a drape is not valid beyond."""


class LeastSquares(Protocol):
    """A least-squares problem in unknowns x (n,), scaled so that 1 is a typical step.

    Attributes:
        start, low, high: (n,) initial guess and bounds.
    """

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
    """Stopping criteria.

    Attributes:
        evaluations: maximum number of evaluations of the value, each a simulation.
        step: minimum step, in the problem's units.
        decrease: minimum predicted decrease of a step, relative to the value.
    """

    evaluations: int = 25
    step: float = 1e-3
    decrease: float = 1e-4


@dataclass(frozen=True)
class Point:
    """An improvement: number of evaluations, unknowns (n,) and value."""

    evaluations: int
    x: np.ndarray
    value: float


@dataclass
class Outcome:
    """The best point found.

    Attributes:
        x: (n,), value: there.
        evaluations: of the value.
        status, message: how it ended.
        trace: all improvements, the start first.
    """

    x: np.ndarray
    value: float
    evaluations: int
    status: Status
    message: str
    trace: list[Point] = field(default_factory=list)


Report = Callable[[Point, int], None]
"""Called after every evaluation with the best point so far and the evaluations made."""


def minimise(
    problem: LeastSquares,
    *,
    method: "Method | None" = None,
    limits: Limits | None = None,
    report: Report | None = None,
) -> Outcome:
    """Minimise ``problem``.

    Args:
        method: Levenberg-Marquardt unless given.
        report: for a progress bar.
    """
    run = Run(problem, limits or Limits(), report)
    try:
        status, message = Status.FAILED, "the start cannot be simulated"
        if math.isfinite(run.value(np.clip(problem.start, problem.low, problem.high))):
            status, message = (method or levenberg_marquardt)(run)
    except Done as done:
        status, message = done.args
    best = run.trace[-1] if run.trace else Point(0, problem.start, math.inf)
    return Outcome(best.x, best.value, run.evaluations, status, message, run.trace)


Method = Callable[["Run"], tuple[Status, str]]
"""Optimises from the evaluated start by :meth:`Run.value`; returns status and message."""


class Done(Exception):  # noqa: N818 (ends a method from within a library's loop)
    """Raised with a status and a message when a limit is reached."""


class Run:
    """One optimisation: counts evaluations, records improvements, stops at the limits."""

    def __init__(
        self, problem: LeastSquares, limits: Limits, report: Report | None
    ) -> None:
        self.problem, self.limits = problem, limits
        self.evaluations = 0
        self.trace: list[Point] = []
        self._report = report

    def value(self, x: np.ndarray) -> float:
        """The problem's value at unknowns (n,), counted."""
        if self.evaluations >= self.limits.evaluations:
            raise Done(Status.EXHAUSTED, f"{self.evaluations} simulations, as many as allowed")
        value = float(self.problem.value(x))
        value = value if math.isfinite(value) else math.inf
        self.evaluations += 1
        if value < (self.trace[-1].value if self.trace else math.inf):
            self.trace.append(Point(self.evaluations, np.array(x), value))
        if self._report and self.trace:
            self._report(self.trace[-1], self.evaluations)
        return value

    @property
    def best(self) -> Point:
        """The best point so far."""
        return self.trace[-1]


def levenberg_marquardt(run: Run) -> tuple[Status, str]:
    """Gauss-Newton with a trust region and active bounds.

    The step minimises the linearised problem within the radius, so that unknowns of low sensitivity
    change little.
    """
    problem, limits = run.problem, run.limits
    x, value = run.best.x, run.best.value
    radius = 0.5 * MAX_STEP
    while True:
        linearised = problem.linearised(x)
        if linearised is None:
            return ((Status.STALLED if len(run.trace) > 1 else Status.FAILED),
                    "the drape has no derivatives here")
        residuals, jacobian = linearised
        gradient, curvature = jacobian.T @ residuals, jacobian.T @ jacobian
        at_bound = ((x <= problem.low) & (gradient > 0)) | ((x >= problem.high) & (gradient < 0))
        free = np.flatnonzero(~at_bound)
        while True:
            step = np.zeros(len(x))
            step[free] = _step_within(gradient[free], curvature[np.ix_(free, free)], radius)
            full_step = np.linalg.norm(step) < 0.99 * radius
            step = np.clip(x + step, problem.low, problem.high) - x
            length = float(np.linalg.norm(step))
            promised = -(gradient @ step + 0.5 * step @ curvature @ step)
            if length < limits.step or promised < limits.decrease * value:
                # A full step means convergence; otherwise the radius has become too small.
                return ((Status.CONVERGED, "no step is worth taking") if full_step
                        else (Status.STALLED, "no step leads down"))
            trial = run.value(x + step)
            gain = (value - trial) / promised
            if gain > 0.75 and not full_step:
                radius = min(2 * radius, MAX_STEP)
            elif gain < 0.25:
                radius = 0.3 * length
            if trial < value:
                x, value = x + step, trial
                break


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
