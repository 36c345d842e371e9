"""Refinement as a least-squares problem: unknowns -> equilibrium -> residuals, with the prior's.

The unknowns are free parameters of the specimen (:mod:`.unknowns`) and the objective's nuisances,
each divided by a typical step. The warm start from the best drape so far keeps the folds.
"""

import math
from collections.abc import Callable, Collection
from dataclasses import dataclass, field, replace

import numpy as np

from common.types import RestPoints
from data.fabrics.fabrics import from_theta
from drapenet.refine.objective import (
    NUISANCE_REACH,
    Linearised,
    Moves,
    Nuisance,
    Objective,
    value,
)
from drapenet.refine.unknowns import BOUNDS, NAMES, SCALE, SpecimenPrior, Unknowns, drape_moves
from sim.draping import Drape, follow
from sim.energies.base import Energy
from sim.material import is_admissible
from sim.sensitivity import Sensitivities, Tangent
from sim.solver.potential import forces

SpringsAt = Callable[[Nuisance], Energy]
"""Springs that hold the simulated cloth; a captured surface depends on the estimated pose."""
_STEP = 1e-3  # of finite differences by a nuisance, in its scale


@dataclass(frozen=True)
class Trial:
    """One evaluated point x (n,): ``value`` of objective and prior, ``misfit`` of the objective."""

    x: np.ndarray
    unknowns: Unknowns
    nuisance: Nuisance
    drape: Drape
    value: float
    misfit: float


@dataclass
class Effort:
    """Equilibria computed by a search, and messages of those that did not converge."""

    solves: int = 0
    failures: list[str] = field(default_factory=list)


class Problem:
    """The unknowns of one specimen's refinement (:class:`.minimise.LeastSquares`).

    Args:
        near: warm start of the first simulation, a drape on the objective's mesh.
        unknowns, nuisance: initial guesses; clipped to the bounds.
        free: names of the free parameters of :data:`.unknowns.NAMES`.
        rest: of the mesh without offset and turn; None: those of ``near``.
        error_scale: divisor of the objective's residuals, above 1 where the best fit exceeds their
            standard deviations.
    """

    def __init__(
        self, near: Drape, unknowns: Unknowns, objective: Objective, *,
        free: Collection[str], prior: SpecimenPrior | None = None, rest: RestPoints | None = None,
        nuisance: Nuisance | None = None, springs: SpringsAt | None = None,
        error_scale: float = 1.0, effort: Effort | None = None,
    ) -> None:
        self.objective, self.prior, self.error_scale = objective, prior, error_scale
        self.effort = effort or Effort()
        self._near, self._springs, self._unknowns = near, springs, unknowns
        self._rest = near.rest if rest is None else rest
        self._free = np.array([name in free for name in NAMES])
        self.size = int(self._free.sum())  # of the specimen's unknowns; the nuisances follow
        nuisance = objective.start if nuisance is None else nuisance
        self.names = (*(name for name in NAMES if name in free), *objective.nuisances)
        self.scale = np.concatenate([SCALE[self._free], objective.scale])
        reach = NUISANCE_REACH * objective.scale
        low, high = BOUNDS[self._free].T
        self.low = np.concatenate([low, nuisance - reach]) / self.scale
        self.high = np.concatenate([high, nuisance + reach]) / self.scale
        start = np.concatenate([unknowns.values[self._free], nuisance]) / self.scale
        self.start = np.clip(start, self.low, self.high)
        self.best: Trial | None = None
        self.last: Trial | None = None
        self.measurements = 0.0  # independent ones, set by :meth:`linearised`
        self._tangent: tuple[Drape, Moves | None, Sensitivities | None] | None = None

    def split(self, x: np.ndarray) -> tuple[Unknowns, Nuisance]:
        """The specimen and the nuisances of x (n,)."""
        values = self._unknowns.values.copy()
        values[self._free] = (x * self.scale)[: self.size]
        return Unknowns(values), (x * self.scale)[self.size :]

    def value(self, x: np.ndarray) -> float:
        """The value at x (n,); infinite for inadmissible moduli or without an equilibrium."""
        unknowns, nuisance = self.split(x)
        drape = self._drape(unknowns, nuisance)
        if drape is None:
            return math.inf
        misfit = value(self.objective.residuals(drape.positions, nuisance))
        trial = Trial(np.array(x), unknowns, nuisance, drape, math.inf, misfit)
        trial = self.last = replace(trial, value=self.total(trial))
        if math.isfinite(trial.value) and (self.best is None or trial.value < self.best.value):
            self.best = trial
        return trial.value

    @property
    def optimum(self) -> Trial:
        """The best trial, of a problem that has one."""
        assert self.best is not None
        return self.best

    def weigh(self) -> None:
        """Set :attr:`error_scale` from the best trial's residuals, and update its value."""
        best = self.optimum
        measurements = max(self._linear(best).independent, 1.0)
        self.error_scale = math.sqrt(max(2 * best.misfit / measurements, 1.0))
        self.best = self.last = replace(best, value=self.total(best))

    def total(self, trial: Trial) -> float:
        """The value of a trial with the present :attr:`error_scale`."""
        return trial.misfit / self.error_scale**2 + value(self._prior_residuals(trial))

    def linearised(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        """Residuals (N,) and derivatives (N, n) at x (n,), the last or the best trial's."""
        trial = next((t for t in (self.last, self.best)
                      if t is not None and np.array_equal(t.x, x)), None)
        if trial is None or (moves := self._moves(trial)) is None:
            return None
        linear = self._linear(trial)
        self.measurements = linear.independent
        jacobian = linear.along(moves)
        jacobian[:, self.size :] += linear.by_nuisance
        rows = [jacobian / self.error_scale]
        if self.prior is not None:
            of_specimen = np.zeros((len(NAMES), len(x)))
            of_specimen[:, : self.size] = self.prior.root[:, self._free]
            rows.append(of_specimen)
        of_nuisance = np.zeros((len(trial.nuisance), len(x)))
        of_nuisance[:, self.size :] = np.diag(1 / self.objective.deviation)
        return (np.concatenate([linear.residuals / self.error_scale, self._prior_residuals(trial)]),
                np.concatenate([*rows, of_nuisance]) * self.scale)

    def _linear(self, trial: Trial) -> Linearised:
        return self.objective.linearised(trial.drape.positions, trial.nuisance)

    def _prior_residuals(self, trial: Trial) -> np.ndarray:
        """(M,) of specimen and nuisances."""
        of_nuisance = (trial.nuisance - self.objective.start) / self.objective.deviation
        if self.prior is None:
            return of_nuisance
        return np.concatenate([self.prior.residuals(trial.unknowns), of_nuisance])

    def _drape(self, unknowns: Unknowns, nuisance: Nuisance) -> Drape | None:
        """The equilibrium, warm start from the best drape; None if there is none."""
        for trial in (self.last, self.best):
            if (trial is not None and np.array_equal(trial.unknowns.values, unknowns.values)
                    and (self._springs is None or np.array_equal(trial.nuisance, nuisance))):
                return trial.drape
        if not is_admissible(*from_theta(unknowns.theta)):
            return None
        near = self._near if self.best is None else self.best.drape
        by_moduli = (self._tangent and self._tangent[0] is near and self._tangent[2]) or None
        rest = unknowns.rest(self._rest, near.rig)
        if not np.array_equal(rest, near.mesh.rest):
            near, by_moduli = near.on(near.mesh.with_rest(rest)), None
        self.effort.solves += 1
        extra = [self._springs(nuisance)] if self._springs else []
        start = by_moduli and by_moduli.prediction(near, unknowns.fabric, laws=unknowns.laws,
                                                   extra=extra)
        drape = follow(near, unknowns.fabric, keep=True, laws=unknowns.laws, extra=extra,
                       start=start)
        if not drape.converged:
            self.effort.failures.append(f"{drape.searched.status.value}: {drape.message}")
            return None
        return drape

    def _moves(self, trial: Trial) -> Moves | None:
        """Derivatives of the vertices by the unknowns; None if they do not exist."""
        if self._tangent is None or self._tangent[0] is not trial.drape:
            tangent = Tangent.of(trial.drape)
            self._tangent = trial.drape, None, None
            if tangent.ok:
                moves, by_moduli = drape_moves(tangent, trial.unknowns, trial.drape.rig,
                                               self.names[: self.size])
                moves = np.concatenate([moves, self._spring_moves(tangent, trial.nuisance)])
                self._tangent = trial.drape, moves, by_moduli
            else:
                self.effort.failures.append(tangent.message)
        return self._tangent[1]

    def _spring_moves(self, tangent: Tangent, nuisance: Nuisance) -> Moves:
        """Derivatives of the vertices by the nuisances through the springs."""
        moves = np.zeros((len(nuisance), tangent.coordinates // 3, 3))
        if (springs := self._springs) is None:
            return moves
        for k, step in enumerate(np.diag(_STEP * self.objective.scale)):
            ahead, back = (forces([springs(nuisance + sign * step)], tangent.q,
                                  tangent.cloth.potential.unknowns) for sign in (1, -1))
            if (push := (ahead - back) / (2 * step[k])).any():
                moves[k] = -tangent.response(push)[: tangent.coordinates].reshape(-1, 3)
        return moves


@dataclass(frozen=True)
class Uncertainty:
    """A normal distribution around the optimum: Laplace's approximation."""

    names: tuple[str, ...]  # of the n unknowns
    covariance: np.ndarray  # (n, n) in their units
    reduced_chi2: float  # of the objective's residuals, per measurement: most unknowns have priors

    @property
    def theta(self) -> np.ndarray:
        """(6, 6) covariance of the moduli."""
        return self.covariance[:6, :6]


def laplace(problem: Problem, trial: Trial) -> Uncertainty | None:
    """Laplace approximation at the best or last ``trial``, None without derivatives; unidentifiable
    unknowns have infinite variance.
    """
    linearised = problem.linearised(trial.x)
    if linearised is None:
        return None
    jacobian = linearised[1]
    values, vectors = np.linalg.eigh(jacobian.T @ jacobian)
    with np.errstate(divide="ignore"):
        variances = np.where(values > 1e-12 * values[-1], 1 / values, np.inf)
    weights = np.where(vectors**2 > 1e-12, vectors**2, 0.0)
    sure = np.isfinite(variances)
    covariance = (vectors[:, sure] * variances[sure]) @ vectors[:, sure].T
    covariance[np.diag_indices_from(covariance)] = np.where(
        weights[:, ~sure].any(axis=1), np.inf, np.diag(covariance))
    return Uncertainty(problem.names, covariance * np.outer(problem.scale, problem.scale),
                       2 * trial.misfit / max(problem.measurements, 1.0))
