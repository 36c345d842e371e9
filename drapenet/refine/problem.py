"""Refinement as a least-squares problem: unknowns -> equilibrium -> residuals, with the prior's.

The unknowns are free parameters of the specimen (:mod:`.cloth`) and the objective's nuisances, each
divided by a typical step. Every simulation has a warm start from the best drape so far, which keeps
the fold configuration; an equilibrium takes a few Newton steps.
"""

import math
from collections.abc import Callable, Collection
from dataclasses import dataclass, field, replace

import numpy as np

from data.fabrics.fabrics import from_theta
from drapenet.refine.objective import NUISANCE_REACH, Objective, value
from drapenet.refine.unknowns import BOUNDS, SCALE, UNKNOWNS, Cloth, Knowledge, cloth_moves
from sim.drape import DrapeResult
from sim.energies.base import Energy
from sim.material import is_admissible
from sim.sensitivity import Sensitivities, Tangent, follow
from sim.solver.potential import forces

Hold = Callable[[np.ndarray], Energy]
"""Springs that hold the simulated cloth, as a function of the objective's nuisances (K,), because
the placement of a captured surface depends on the estimated pose."""


_STEP = 1e-3  # of finite differences by a nuisance, in its scale


@dataclass(frozen=True)
class Trial:
    """One evaluated point.

    Attributes:
        x: (n,) unknowns.
        cloth: the specimen; nuisance: (K,) of the objective.
        drape: its equilibrium.
        value: of objective and prior.
        misfit: half the sum of squares of the objective's residuals.
    """

    x: np.ndarray
    cloth: Cloth
    nuisance: np.ndarray
    drape: DrapeResult
    value: float
    misfit: float


@dataclass
class Effort:
    """Simulations made by a search.

    Attributes:
        solves: equilibria computed.
        failures: messages of simulations that did not converge.
    """

    solves: int = 0
    failures: list[str] = field(default_factory=list)


class Problem:
    """The unknowns of one specimen's refinement (:class:`.optimisers.LeastSquares`).

    Args:
        near: warm start of the first simulation, a drape on the objective's mesh.
        cloth: initial guess; clipped to the bounds.
        objective: compares drape and capture.
        free: names of the free parameters of :data:`.cloth.UNKNOWNS`.
        known: prior; None for none.
        rest: (V, 2) m, rest points of the mesh without offset and turn; None: those of ``near``.
        nuisance: (K,) initial guess of the nuisances; None: the objective's.
        hold: the springs; None for none.
        error_scale: divisor of the objective's residuals, above 1 where the best fit exceeds their
            standard deviations.
        effort: counter of simulations; None: a new one.

    Attributes:
        names: (n,) of the unknowns.
        scale: (n,) their units.
        start, low, high: (n,) in these units.
        best, last: trials, None before the first.
        measurements: number of independent measurements; set by :meth:`linearised`.
    """

    def __init__(
        self,
        near: DrapeResult,
        cloth: Cloth,
        objective: Objective,
        *,
        free: Collection[str],
        known: Knowledge | None = None,
        rest: np.ndarray | None = None,
        nuisance: np.ndarray | None = None,
        hold: Hold | None = None,
        error_scale: float = 1.0,
        effort: Effort | None = None,
    ) -> None:
        self.objective, self.known, self.error_scale = objective, known, error_scale
        self.effort = effort or Effort()
        self._near, self._hold, self._cloth = near, hold, cloth
        self._rest = near.rest if rest is None else rest
        self._free = np.array([name in free for name in UNKNOWNS])
        own = objective.start if nuisance is None else np.asarray(nuisance, dtype=np.float64)
        self.names = (*(name for name in UNKNOWNS if name in free), *objective.nuisances)
        self.scale = np.concatenate([SCALE[self._free], objective.scale])
        reach = NUISANCE_REACH * np.asarray(objective.scale)
        low, high = (np.concatenate([limits[self._free], own + sign * reach]) / self.scale
                     for limits, sign in zip(BOUNDS.T, (-1, 1), strict=True))
        self.low, self.high = low, high
        start = np.concatenate([cloth.values[self._free], own]) / self.scale
        self.start = np.clip(start, low, high)
        self.best: Trial | None = None
        self.last: Trial | None = None
        self.measurements = 0.0
        self._tangent: tuple[DrapeResult, np.ndarray | None, Sensitivities | None] | None = None

    @property
    def cloths(self) -> int:
        """Number of the specimen's unknowns, which precede the nuisances."""
        return int(self._free.sum())

    def split(self, x: np.ndarray) -> tuple[Cloth, np.ndarray]:
        """The specimen and the objective's nuisances (K,) of x (n,)."""
        values, number = self._cloth.values.copy(), self.cloths
        values[self._free] = x[:number] * self.scale[:number]
        return Cloth(values), x[number:] * self.scale[number:]

    def value(self, x: np.ndarray) -> float:
        """The value at x (n,); infinite for inadmissible moduli or without an equilibrium."""
        cloth, nuisance = self.split(x)
        drape = self._drape(cloth, nuisance)
        if drape is None:
            return math.inf
        misfit = value(self.objective.residuals(drape.positions, nuisance))
        trial = Trial(np.array(x), cloth, nuisance, drape, math.inf, misfit)
        trial = self.last = replace(trial, value=self.total(trial))
        if math.isfinite(trial.value) and (self.best is None or trial.value < self.best.value):
            self.best = trial
        return trial.value

    def weigh(self) -> None:
        """Set :attr:`error_scale` from the best trial's residuals, and update its value."""
        best = self.best
        found = self.objective.linearised(best.drape.positions, best.nuisance)
        freedom = max(found.independent - len(best.x), 1.0)
        self.error_scale = math.sqrt(max(2 * best.misfit / freedom, 1.0))
        self.best = self.last = replace(best, value=self.total(best))

    def total(self, trial: Trial) -> float:
        """The value of a trial with the present :attr:`error_scale`."""
        return (trial.misfit / self.error_scale**2
                + value(self._beforehand(trial.cloth, trial.nuisance)))

    def linearised(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        """Residuals (N,) and derivatives (N, n) at x (n,), the last or the best trial's."""
        trial = next((t for t in (self.last, self.best)
                      if t is not None and np.array_equal(t.x, x)), None)
        moves = None if trial is None else self._moves(trial)
        if moves is None:
            return None
        found = self.objective.linearised(trial.drape.positions, trial.nuisance)
        self.measurements = found.independent
        number = self.cloths
        jacobian = found.along(moves)
        jacobian[:, number:] += found.by_nuisance
        jacobian /= self.error_scale
        roots = []
        if self.known is not None:
            own = np.zeros((len(UNKNOWNS), len(x)))
            own[:, :number] = self.known.root[:, self._free]
            roots.append(own)
        own = np.zeros((len(trial.nuisance), len(x)))
        own[:, number:] = np.diag(1 / self.objective.deviation)
        return (np.concatenate([found.residuals / self.error_scale,
                                self._beforehand(trial.cloth, trial.nuisance)]),
                np.concatenate([jacobian, *roots, own]) * self.scale)

    def _beforehand(self, cloth: Cloth, nuisance: np.ndarray) -> np.ndarray:
        """(M,) residuals of the prior of specimen and nuisances."""
        own = (nuisance - self.objective.start) / self.objective.deviation
        return own if self.known is None else np.concatenate([self.known.residuals(cloth), own])

    def _drape(self, cloth: Cloth, nuisance: np.ndarray) -> DrapeResult | None:
        """The equilibrium of ``cloth``, warm start from the best drape; None if there is none."""
        for trial in (self.last, self.best):
            if (trial is not None and np.array_equal(trial.cloth.values, cloth.values)
                    and (self._hold is None or np.array_equal(trial.nuisance, nuisance))):
                return trial.drape
        if not is_admissible(*from_theta(cloth.theta)):
            return None
        near = self._near if self.best is None else self.best.drape
        here = (self._tangent and self._tangent[0] is near and self._tangent[2]) or None
        rest = cloth.rest(self._rest, near.rig)
        if not np.array_equal(rest, near.mesh.rest):
            near, here = replace(near, mesh=near.mesh.with_rest(rest)), None
        self.effort.solves += 1
        drape = follow(near, cloth.fabric, keep=True, laws=cloth.laws,
                       extra=[self._hold(nuisance)] if self._hold else [],
                       sensitivities=here)
        if not drape.converged:
            self.effort.failures.append(f"{drape.status.value}: {drape.message}")
            return None
        return drape

    def _moves(self, trial: Trial) -> np.ndarray | None:
        """Derivatives (n, V, 3) of the vertices by the unknowns; None if they do not exist."""
        if self._tangent is None or self._tangent[0] is not trial.drape:
            tangent = Tangent.of(trial.drape)
            if tangent.ok:
                moves, by_moduli = cloth_moves(tangent, trial.cloth, trial.drape.rig,
                                               self.names[: self.cloths])
                moves = np.concatenate([moves, self._pulled(tangent, trial.nuisance)])
                self._tangent = trial.drape, moves, by_moduli
            else:
                self.effort.failures.append(tangent.message)
                self._tangent = trial.drape, None, None
        return self._tangent[1]

    def _pulled(self, tangent: Tangent, nuisance: np.ndarray) -> np.ndarray:
        """(K, V, 3) derivatives of the vertices by the nuisances through the springs."""
        moves = np.zeros((len(nuisance), tangent.coordinates // 3, 3))
        steps = np.diag(_STEP * np.asarray(self.objective.scale))
        for k, step in enumerate(steps if self._hold else []):
            ahead, back = (forces([self._hold(nuisance + sign * step)], tangent.q,
                                  tangent.cloth.potential.unknowns) for sign in (1, -1))
            if (push := (ahead - back) / (2 * step[k])).any():
                moves[k] = -tangent.response(push)[: tangent.coordinates].reshape(-1, 3)
        return moves


@dataclass(frozen=True)
class Uncertainty:
    """A normal distribution around the optimum: Laplace's approximation.

    Attributes:
        names: (n,) of the unknowns.
        covariance: (n, n) in their units.
        reduced_chi2: chi-square of the objective's residuals per degree of freedom.
    """

    names: tuple[str, ...]
    covariance: np.ndarray
    reduced_chi2: float

    @property
    def theta(self) -> np.ndarray:
        """(6, 6) covariance of the moduli."""
        return self.covariance[:6, :6]


def laplace(problem: Problem, trial: Trial) -> Uncertainty | None:
    """Laplace approximation at ``trial``, the problem's best or last; None without derivatives.

    The weight of the objective is that of the problem. Unidentifiable unknowns have infinite
    variance.
    """
    linearised = problem.linearised(trial.x)
    if linearised is None:
        return None
    jacobian = linearised[1]
    freedom = max(problem.measurements - len(trial.x), 1.0)
    values, vectors = np.linalg.eigh(jacobian.T @ jacobian)
    with np.errstate(divide="ignore"):
        variances = np.where(values > 1e-12 * values[-1], 1 / values, np.inf)
    weights = np.where(vectors**2 > 1e-12, vectors**2, 0.0)
    sure = np.isfinite(variances)
    covariance = (vectors[:, sure] * variances[sure]) @ vectors[:, sure].T
    covariance[np.diag_indices_from(covariance)] = np.where(
        weights[:, ~sure].any(axis=1), np.inf, np.diag(covariance))
    return Uncertainty(problem.names, covariance * np.outer(problem.scale, problem.scale),
                       2 * trial.misfit / freedom)
