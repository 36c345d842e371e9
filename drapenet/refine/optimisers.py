"""Optimisers for few unknowns whose every evaluation is a simulation, behind one interface.

    outcome = minimise(problem, method="lm", limits=Limits(evaluations=25))

``lm`` (Levenberg-Marquardt) and ``gauss_newton`` use the residuals and their derivatives,
``lbfgs`` the gradient only, ``cmaes`` and ``one_plus_one`` values only; the latter three are there
to be compared with. All keep within bounds, take a failed simulation for a rejected step, return
the best point ever evaluated, so never one worse than the start, and hand it back when they are
interrupted.
"""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum
from functools import partial
from typing import Protocol

import numpy as np
from scipy.optimize import brentq
from scipy.optimize import minimize as scipy_minimise

from common.ctrl_c import require_interruption

SIGMA = 0.3  # first deviation of the evolution strategies, in the problem's units
_FAILED = 1e30  # stands for an infinite value where a method needs a number


class LeastSquares(Protocol):
    """What is minimised: half a sum of squares over unknowns x (n,), scaled so that 1 is a step.

    Attributes:
        start, low, high: (n,) first point and bounds.
    """

    start: np.ndarray
    low: np.ndarray
    high: np.ndarray

    def value(self, x: np.ndarray) -> float:
        """The value at ``x``, infinite where there is none."""

    def linearised(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        """Residuals (N,) and their derivatives (N, n) where :meth:`value` is finite and was asked
        last or is the best so far; None if there are no derivatives."""


class Status(str, Enum):
    """How an optimisation ended."""

    CONVERGED = "converged"
    STALLED = "stalled"  # no step leads down, though the derivatives promise one
    EXHAUSTED = "exhausted"  # as many evaluations as allowed
    INTERRUPTED = "interrupted"
    FAILED = "failed"  # the start itself has no value or no derivatives


@dataclass(frozen=True)
class Limits:
    """When to stop.

    Attributes:
        evaluations: of the value, each a simulation.
        step: smallest step, in the problem's units.
        decrease: smallest decrease worth a step, relative to the value.
        target: value that is good enough.
        longest: longest step, in the problem's units; further away a linearised drape says
            little. Of Levenberg-Marquardt and Gauss-Newton.
    """

    evaluations: int = 25
    step: float = 1e-3
    decrease: float = 1e-4
    target: float = 0.0
    longest: float = 1.0


@dataclass(frozen=True)
class Point:
    """An improvement: after how many evaluations and seconds, where, and how good."""

    evaluations: int
    seconds: float
    x: np.ndarray
    value: float


@dataclass
class Outcome:
    """The best point found.

    Attributes:
        x: (n,), value: there.
        evaluations: of the value; iterations: steps taken, or generations.
        status, message: how it ended.
        trace: all improvements, the start first.
    """

    x: np.ndarray
    value: float
    evaluations: int
    iterations: int
    status: Status
    message: str
    trace: list[Point] = field(default_factory=list)


Report = Callable[[Point, int], None]
"""Called after every evaluation with the best point so far and the evaluations made."""


def minimise(
    problem: LeastSquares,
    *,
    method: str = "lm",
    limits: Limits | None = None,
    report: Report | None = None,
    seed: int = 0,
) -> Outcome:
    """Minimise ``problem`` by a method of :data:`METHODS`.

    Args:
        report: for a progress bar.
        seed: of the evolution strategies.
    """
    run = _Run(problem, limits or Limits(), report, seed)
    try:
        status, message = Status.FAILED, "the start cannot be simulated"
        if math.isfinite(run.value(np.clip(problem.start, problem.low, problem.high))):
            status, message = METHODS[method](run)
    except _Done as done:
        status, message = done.args
    except (KeyboardInterrupt, SystemError) as error:
        require_interruption(error)
        status, message = Status.INTERRUPTED, "interrupted; the best so far"
    best = run.trace[-1] if run.trace else Point(0, 0.0, problem.start, math.inf)
    return Outcome(best.x, best.value, run.evaluations, run.iterations, status, message, run.trace)


class _Done(Exception):  # noqa: N818 (ends a method from within a library's loop)
    """Raised with a status and a message when a limit is reached."""


class _Run:
    """One optimisation: counts, keeps the best, and stops at the limits."""

    def __init__(
        self, problem: LeastSquares, limits: Limits, report: Report | None, seed: int
    ) -> None:
        self.problem, self.limits, self.seed = problem, limits, seed
        self.evaluations = self.iterations = 0
        self.trace: list[Point] = []
        self._report = report
        self._began = time.perf_counter()

    def value(self, x: np.ndarray) -> float:
        """The problem's value, counted."""
        if self.evaluations >= self.limits.evaluations:
            raise _Done(Status.EXHAUSTED, f"{self.evaluations} simulations, as many as allowed")
        value = float(self.problem.value(x))
        value = value if math.isfinite(value) else math.inf
        self.evaluations += 1
        if value < (self.trace[-1].value if self.trace else math.inf):
            self.trace.append(Point(self.evaluations, time.perf_counter() - self._began,
                                    np.array(x), value))
        if self._report and self.trace:
            self._report(self.trace[-1], self.evaluations)
        if value <= self.limits.target:
            raise _Done(Status.CONVERGED, "the value is as small as asked for")
        return value

    @property
    def best(self) -> Point:
        """The best point so far."""
        return self.trace[-1]


def _levenberg_marquardt(run: _Run, damped: bool) -> tuple[Status, str]:
    """Gauss-Newton within a region of trust; unknowns at a bound that want to leave it stay.

    Damped, the step is the best one of the linearised problem no longer than the radius, and what
    the residuals hardly depend on hardly moves. Otherwise it is the whole step, shortened.
    """
    problem, limits = run.problem, run.limits
    x, value = run.best.x, run.best.value
    radius = limits.longest if not damped else 0.5 * limits.longest
    while True:
        linearised = problem.linearised(x)
        if linearised is None:
            return ((Status.STALLED if run.iterations else Status.FAILED),
                    "the drape has no derivatives here")
        residuals, jacobian = linearised
        gradient, curvature = jacobian.T @ residuals, jacobian.T @ jacobian
        at_bound = ((x <= problem.low) & (gradient > 0)) | ((x >= problem.high) & (gradient < 0))
        free = np.flatnonzero(~at_bound)
        while True:
            step = np.zeros(len(x))
            step[free] = _step_within(gradient[free], curvature[np.ix_(free, free)], radius,
                                      damped=damped)
            whole = np.linalg.norm(step) < 0.99 * radius
            step = np.clip(x + step, problem.low, problem.high) - x
            length = float(np.linalg.norm(step))
            promised = -(gradient @ step + 0.5 * step @ curvature @ step)
            if length < limits.step or promised < limits.decrease * value:
                # With a whole step nothing more is promised; else the radius has shrunk to nothing.
                return ((Status.CONVERGED, "no step is worth taking") if whole
                        else (Status.STALLED, "no step leads down"))
            trial = run.value(x + step)
            gain = (value - trial) / promised
            if gain > 0.75 and not whole:
                radius = min(2 * radius, limits.longest)
            elif gain < 0.25:
                radius = 0.3 * length
            if trial < value:
                x, value = x + step, trial
                run.iterations += 1
                break


def _step_within(
    gradient: np.ndarray, curvature: np.ndarray, radius: float, *, damped: bool
) -> np.ndarray:
    """The step (n,) that minimises the quadratic, no longer than ``radius``."""
    if not len(gradient):
        return np.zeros(0)
    values, vectors = np.linalg.eigh(curvature)
    # What nothing depends on stays.
    values = np.maximum(values, 1e-12 * max(values[-1], 1e-300))
    slopes = vectors.T @ gradient

    def step(damping: float) -> np.ndarray:
        return -vectors @ (slopes / (values + damping))

    def excess(log_damping: float) -> float:
        return float(np.linalg.norm(step(math.exp(log_damping)))) - radius

    length = float(np.linalg.norm(step(0.0)))
    if length <= radius:
        return step(0.0)
    if not damped:
        return step(0.0) * (radius / length)
    low = math.log(values[0]) - 40
    high = math.log(max(np.linalg.norm(gradient) / radius, values[0])) + 1
    return step(math.exp(brentq(excess, low, high, xtol=1e-3)))


def _lbfgs(run: _Run) -> tuple[Status, str]:
    """SciPy's L-BFGS-B on the value and its gradient."""
    problem, limits = run.problem, run.limits
    first = run.best

    def value_and_gradient(x: np.ndarray) -> tuple[float, np.ndarray]:
        value = first.value if np.array_equal(x, first.x) else run.value(x)
        linearised = problem.linearised(x) if math.isfinite(value) else None
        if linearised is None:
            # A wall: the line search turns back, and no slope leads it astray.
            return 10.0, np.zeros_like(x)
        residuals, jacobian = linearised
        return value / first.value, jacobian.T @ residuals / first.value

    def count(_: np.ndarray) -> None:
        run.iterations += 1

    result = scipy_minimise(
        value_and_gradient, first.x, jac=True, method="L-BFGS-B", callback=count,
        bounds=list(zip(problem.low, problem.high, strict=True)),
        options={"ftol": limits.decrease, "gtol": 1e-9, "maxfun": 10**6, "maxiter": 10**6})
    return (Status.CONVERGED if result.success else Status.STALLED), str(result.message)


def _cma_es(run: _Run) -> tuple[Status, str]:
    """CMA-ES of the package cma, with its own size of population."""
    import cma  # takes a while

    problem, limits = run.problem, run.limits
    strategy = cma.CMAEvolutionStrategy(run.best.x, SIGMA, {
        "bounds": [problem.low.tolist(), problem.high.tolist()], "seed": run.seed + 1,
        "verbose": -9, "tolx": limits.step / 10, "tolfun": 0, "tolfunhist": 0, "tolflatfitness": 5,
    })
    while not strategy.stop():
        points = strategy.ask()
        strategy.tell(points, [min(run.value(np.asarray(x)), _FAILED) for x in points])
        run.iterations += 1
    return Status.CONVERGED, f"cma stopped: {', '.join(strategy.stop())}"


def _one_plus_one(run: _Run) -> tuple[Status, str]:
    """(1+1)-ES: one parent, one child, a step size for one success in five."""
    problem, limits = run.problem, run.limits
    rng = np.random.default_rng(run.seed)
    sigma = SIGMA
    while sigma > limits.step / 10:
        before = run.best
        run.value(np.clip(before.x + sigma * rng.standard_normal(len(before.x)),
                          problem.low, problem.high))
        better = run.best is not before
        run.iterations += better
        sigma *= 1.5 if better else 1.5**-0.25
    return Status.CONVERGED, "the step size has become small"


METHODS: dict[str, Callable[[_Run], tuple[Status, str]]] = {
    "lm": partial(_levenberg_marquardt, damped=True),
    "gauss_newton": partial(_levenberg_marquardt, damped=False),
    "lbfgs": _lbfgs,
    "cmaes": _cma_es,
    "one_plus_one": _one_plus_one,
}
