"""Minimisation of a smooth energy with a sparse Hessian by a globalised Newton method.

Far from a minimum the Hessian is indefinite. It is blended with a positive semi-definite
approximation, ``convexity`` from 0 (exact) to 1, just far enough for a Cholesky factorisation
to exist, and lowered after success. The Cholesky factor of the exact Hessian at the end proves a
minimum rather than a saddle.
"""

from dataclasses import dataclass
from enum import Enum
from time import thread_time
from typing import Protocol

import numpy as np

from sim.solver.linear import CholeskySolver, SparsePattern, make_solver


class Status(str, Enum):
    """Outcome of a minimisation; only CONVERGED is a verified minimum."""

    CONVERGED = "converged"
    MAX_ITERATIONS = "max_iterations"
    LINE_SEARCH = "line_search"
    SADDLE = "saddle"
    SINGULAR = "singular"
    SELF_CONTACT = "self_contact"
    NOT_FINITE = "not_finite"
    EXCEPTION = "exception"


NUMERICAL_ERRORS = (ArithmeticError, np.linalg.LinAlgError)
"""Exceptions of a single simulation, which ends with the status EXCEPTION; others continue."""


class Model(Protocol):
    """The Hessian at one state."""

    def hessian(self, convexity: float, shift: float) -> np.ndarray:
        """CSR data in the objective's pattern: exact for a ``convexity`` of 0, positive
        semi-definite for 1; ``shift`` times a regularisation is added to the diagonal."""


class Objective(Protocol):
    """A function of states ``q`` to be minimised, such as :class:`sim.solver.potential.Potential`.

    Derivatives are by a step (size,) from a state, which ``moved`` applies. Differences below
    :data:`ROUNDING` of ``energy_scale`` are rounding errors.
    """

    size: int
    energy_scale: float

    @property
    def pattern(self) -> SparsePattern: ...

    def evaluate(self, q: np.ndarray) -> tuple[float, np.ndarray]: ...  # value and gradient
    def model(self, q: np.ndarray) -> Model: ...
    def moved(self, q: np.ndarray, step: np.ndarray) -> np.ndarray: ...
    def allows(self, old: np.ndarray, new: np.ndarray) -> bool: ...
    def residual(self, gradient: np.ndarray) -> float: ...
    def step_length(self, step: np.ndarray) -> float: ...


@dataclass(frozen=True)
class NewtonOptions:
    """Stopping criteria, in the units of the objective's scales."""

    residual: float = 1e-5  # largest of a converged state
    step: float = 1e-5  # largest last step of a converged state
    max_iterations: int = 500
    convexities: tuple[float, ...] = (0.0, 0.1, 0.5, 1.0)
    """Blends of the exact Hessian, 0, with its convex form, 1, in increasing order."""
    extend: bool = True  # whether a step is doubled while the energy falls steeply


@dataclass
class NewtonResult:
    """Final state of a minimisation and its cost."""

    q: np.ndarray  # an equilibrium only if ``status`` is CONVERGED
    status: Status
    message: str
    iterations: int = 0
    residual: float = np.inf  # of the last iteration, scaled, as the step
    step: float = np.inf
    positive_definite: bool = False  # whether the exact Hessian has a Cholesky factor
    factor: CholeskySolver | None = None  # that holds it
    seconds: float = 0.0  # CPU time

    def end(self, status: Status) -> None:
        """Set the outcome and its message."""
        self.status, self.message = status, _ENDINGS[status].format(**vars(self))


MAX_PATIENCE = 4  # steps
SHIFTS = (0.0, 1e-3, 1e-1, 1e1, 1e3)  # of the diagonal, in units of the regularisation
STILL_STEEP = 0.5  # of the slope at the start of a step, from which on the step is doubled
ARMIJO = 1e-4  # required fraction of the predicted decrease
MIN_STEP_FACTOR = 2.0**-30
ROUNDING = 1e-14  # relative to the energy scale
MAX_PERTURBATIONS = 5  # of saddle points
PERTURBATION = 0.1  # first perturbation, in units of the step length
PERTURBATION_GROWTH = 3.0  # a small perturbation may lead back to a flat saddle
PERTURBATION_HALVINGS = 20
PRECISE_RESIDUAL = 1.0  # residual below which exact Newton steps are solved accurately

_ENDINGS = {
    Status.CONVERGED: "equilibrium",
    Status.MAX_ITERATIONS: "residual {residual:.1e} after {iterations} iterations",
    Status.LINE_SEARCH: "no descent at residual {residual:.1e}",
    Status.SADDLE: "stationary but not a minimum",
    Status.SINGULAR: "no regularisation makes the Hessian definite",
    Status.NOT_FINITE: "the energy is not a finite number",
}


def minimise(
    objective: Objective, start: np.ndarray, options: NewtonOptions | None = None, *,
    solver: CholeskySolver | None = None
) -> NewtonResult:
    """Find a local minimum near the state ``start``. Numerical failures raise no exception. The
    factor of a ``solver`` for the objective's pattern is lost. Any function of states with the
    methods of a potential can be minimised."""
    start = np.array(start, dtype=np.float64)
    run, began = _Minimisation(objective, start, options or NewtonOptions(), solver), thread_time()
    with np.errstate(all="ignore"):
        run.iterate()
    run.result.seconds = thread_time() - began
    return run.result


class _Minimisation:
    """State of a running minimisation."""

    def __init__(
        self, objective: Objective, q: np.ndarray, options: NewtonOptions,
        solver: CholeskySolver | None
    ) -> None:
        self.objective, self.options = objective, options
        self.convexity, self.shift = 1.0, 0
        self.wait, self.patience = 0, 1  # steps before less convexity is tried, now and next time
        self.result = NewtonResult(q=q, status=Status.MAX_ITERATIONS, message="")
        self.rng = np.random.default_rng(0)
        self.solver = solver or make_solver(objective.pattern)
        self.model: Model | None = None  # at the present state

    def iterate(self) -> None:
        result, options, perturbations = self.result, self.options, 0
        value, gradient = self.objective.evaluate(self.result.q)
        while result.iterations < options.max_iterations:
            result.residual = self.objective.residual(gradient)
            if not np.isfinite(value) or not np.isfinite(result.residual):
                return result.end(Status.NOT_FINITE)
            if result.residual < options.residual:
                # Only the exact Hessian distinguishes a minimum from a saddle.
                result.positive_definite = self._factorise(0.0, proof=True)
                if result.positive_definite:
                    step = self.solver.solve(-gradient)
                    result.step = self.objective.step_length(step)
                    if result.step < options.step:
                        result.factor = self.solver
                        return result.end(Status.CONVERGED)
                    self.convexity = 0.0
                elif perturbations < MAX_PERTURBATIONS:
                    result.q, self.model = self._perturbed(perturbations), None
                    perturbations += 1
                    value, gradient = self.objective.evaluate(self.result.q)
                    self.convexity = 1.0
                    result.iterations += 1
                    continue
                else:
                    return result.end(Status.SADDLE)
            else:
                step = self._direction(gradient)
            if step is None:
                return result.end(Status.SINGULAR)
            improved = self._search(value, gradient, step)
            if improved is None:
                # The step of a nearly singular model leaves the range in which the model is valid:
                # use a stiffer model at this state. At a stationary point no model is stiffer.
                stationary = result.residual < options.residual
                if stationary or (self.convexity == 1.0 and self.shift == len(SHIFTS) - 1):
                    return result.end(Status.LINE_SEARCH)
                if self.convexity == 1.0:
                    self.shift += 1
                self.convexity, self.wait = 1.0, 1
                result.iterations += 1
                continue
            self.shift = 0
            length, result.q, value, gradient = improved
            self.model = None
            result.step = length * self.objective.step_length(step)
            result.iterations += 1
        result.residual = self.objective.residual(gradient)
        return result.end(Status.MAX_ITERATIONS)

    def _factorise(self, convexity: float, shift: float = 0.0, *, proof: bool = False) -> bool:
        if self.model is None:
            self.model = self.objective.model(self.result.q)
        data = self.model.hessian(convexity, shift)
        return self.solver.factorise(data, rough=not proof)

    def _direction(self, gradient: np.ndarray) -> np.ndarray | None:
        """Newton step with the smallest possible convexity; None if no factor exists."""
        blends = self.options.convexities
        now = blends.index(self.convexity)
        lowest = now if self.wait or self.shift else max(now - 1, 0)
        self.wait = max(self.wait - 1, 0)
        for trial in blends[lowest:-1]:
            if self._factorise(trial):
                self._settle(trial, tried_less=lowest < now)
                rough = trial > 0 or self.result.residual > PRECISE_RESIDUAL
                return self.solver.solve(-gradient, rough=rough)
        self._settle(1.0, tried_less=lowest < now)
        # Near a pole of the energy single precision does not suffice.
        while not any(self._factorise(1.0, SHIFTS[self.shift], proof=proof)
                      for proof in (False, True)):
            if self.shift == len(SHIFTS) - 1:
                return None
            self.shift += 1
        return self.solver.solve(-gradient, rough=True)

    def _settle(self, convexity: float, *, tried_less: bool) -> None:
        """Keep a convexity; each time that less has failed, wait longer before trying it again."""
        if convexity != self.convexity:
            self.patience = 1
        elif tried_less:
            self.wait, self.patience = self.patience, min(2 * self.patience, MAX_PATIENCE)
        self.convexity = convexity

    def _search(
        self, value: float, gradient: np.ndarray, step: np.ndarray
    ) -> tuple[float, np.ndarray, float, np.ndarray] | None:
        """Line search: backtracking from 1, then doubling while the energy decreases."""
        objective, q = self.objective, self.result.q
        slope = float(gradient @ step)
        if not slope < 0:
            return None
        rounding = ROUNDING * objective.energy_scale
        length, best = 1.0, None
        while length > MIN_STEP_FACTOR:
            trial = objective.moved(q, length * step)
            if objective.allows(q, trial):
                reached, slopes = objective.evaluate(trial)
                if reached <= value + ARMIJO * length * slope:
                    best = (length, trial, reached, slopes)
                    break
                if abs(length * slope) < rounding and reached < value + rounding:
                    # The energies differ by rounding errors only: compare the gradients.
                    if objective.residual(slopes) < objective.residual(gradient):
                        return length, trial, reached, slopes
            length /= 2
        if best is None:
            return None
        # Where the energy falls along the step as steeply as before, the step is too short.
        while (best[0] >= 1.0 and self.options.extend
               and float(best[3] @ step) < STILL_STEEP * slope):
            length = 2 * best[0]
            trial = objective.moved(q, length * step)
            if not objective.allows(q, trial):
                break
            reached, slopes = objective.evaluate(trial)
            if not reached < min(best[2], value + ARMIJO * length * slope):
                break
            best = (length, trial, reached, slopes)
        return best

    def _perturbed(self, earlier: int) -> np.ndarray:
        """A random state near a saddle, smoothed by the convex Hessian; its distance grows with the
        number of ``earlier`` perturbations."""
        objective, q = self.objective, self.result.q
        if not self._factorise(1.0, SHIFTS[1]):
            return q
        move = self.solver.solve(self.rng.standard_normal(objective.size))
        move *= PERTURBATION * PERTURBATION_GROWTH**earlier / objective.step_length(move)
        for _ in range(PERTURBATION_HALVINGS):
            there = objective.moved(q, move)
            if objective.allows(q, there):
                return there
            move /= 2
        return q
