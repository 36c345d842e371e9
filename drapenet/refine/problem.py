"""A refinement as a least-squares problem: unknowns -> equilibrium -> objective.

The unknowns are theta (six moduli, :mod:`data.fabrics`), if wanted the membrane's stiffness, and
the objective's nuisances, each divided by the size of a sensible step. Every simulation starts
from the best drape so far, a short way from where it has to go; so the fold configuration stays,
and an equilibrium costs a few Newton steps.
"""

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from data.fabrics import THETA_NAMES, fabric_from_theta, from_theta
from data.prior.gaussian import GaussianPrior
from drapenet.refine.objective import NUISANCE_REACH, Linearised, Objective, value
from sim.drape import DrapeResult
from sim.energies.base import Energy
from sim.laws import Laws
from sim.material import MICRO, is_admissible
from sim.sensitivity import Sensitivities, follow, sensitivities

ALPHA_RANGE = (0.3 * MICRO, 300 * MICRO)  # N·m at 300 g/m²
RATIO_RANGE = (-10e-3, 2e-3)  # m; 99 of 100 fabrics of the prior lie within
MEMBRANE_RANGE = (math.log(0.05), math.log(20.0))  # times the law's own stiffness
ALPHA_SCALE = 1.0  # of log alpha: what counts as 1
RATIO_SCALE = 2e-3  # m
MEMBRANE = "log_membrane"


@dataclass(frozen=True)
class Trial:
    """One evaluated point.

    Attributes:
        x: (n,) unknowns.
        theta: (6,); log_membrane: relative to the law's; nuisance: (K,).
        drape: the equilibrium.
        value: of the objective and the prior.
    """

    x: np.ndarray
    theta: np.ndarray
    log_membrane: float
    nuisance: np.ndarray
    drape: DrapeResult
    value: float


def prior_value(prior: GaussianPrior | None, theta: np.ndarray) -> float:
    """What theta (6,) itself costs: half its squared distance from the prior's mean."""
    return 0.0 if prior is None else value(prior.whiten(theta - prior.mean))


def with_prior(
    prior: GaussianPrior | None, theta: np.ndarray, residuals: np.ndarray, jacobian: np.ndarray,
    by_unknowns: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Residuals (N,) and their derivatives (N, n) with those of the prior, six more.

    Args:
        by_unknowns: (6, n) derivatives of theta.
    """
    if prior is None:
        return residuals, jacobian
    return (np.concatenate([residuals, prior.whiten(theta - prior.mean)]),
            np.concatenate([jacobian, prior.whiten(by_unknowns)]))


class DrapeProblem:
    """The unknowns of one specimen's refinement (:class:`.optimisers.LeastSquares`).

    Args:
        drape: an equilibrium of ``theta`` on the mesh that the objective knows; its laws are those
            of all simulations.
        theta: (6,) where to start; drawn in to the bounds.
        objective: what is compared.
        nuisance: (K,) first values of its parameters; its own unless given.
        membrane: whether the membrane's stiffness is free.
        prior: known beforehand; None for nothing.
        origin: where every simulation starts; None: at the best drape so far. The captured shape,
            where it is known.
        springs: energies that hold the simulated cloth, ``drape`` among it.

    Attributes:
        names: (n,) of the unknowns.
        scale: (n,) units of x: theta = x * scale, and so on.
        start, low, high: (n,) in x.
        best, last: trials, None before the first.
        solves: equilibria computed; derivatives: sensitivities computed.
        measurements: independent ones that the residuals stand for; known after derivatives.
        failures: messages of simulations that did not converge.
        seconds: in simulations, in derivatives, in the objective.
    """

    def __init__(
        self,
        drape: DrapeResult,
        theta: np.ndarray,
        objective: Objective,
        *,
        nuisance: np.ndarray | None = None,
        membrane: bool = False,
        prior: GaussianPrior | None = None,
        origin: DrapeResult | None = None,
        springs: Sequence[Energy] = (),
    ) -> None:
        self.objective, self.prior, self.origin = objective, prior, origin
        self._springs, self._laws, self._membrane = tuple(springs), drape.laws, membrane
        self._first = drape, np.array(theta, dtype=np.float64)
        own = objective.start if nuisance is None else np.asarray(nuisance, dtype=np.float64)
        extra = [MEMBRANE] if membrane else []
        self.names = (*THETA_NAMES, *extra, *objective.nuisances)
        self.scale = np.concatenate([
            [ALPHA_SCALE] * 3, [RATIO_SCALE] * 3, [1.0] * len(extra), objective.scale])
        reach = NUISANCE_REACH * objective.scale
        alpha = np.log(ALPHA_RANGE)
        bounds = [
            np.concatenate([[alpha[k]] * 3, [RATIO_RANGE[k]] * 3,
                            [MEMBRANE_RANGE[k]] * len(extra), own + (2 * k - 1) * reach])
            for k in (0, 1)]
        self.low, self.high = (bound / self.scale for bound in bounds)
        start = np.concatenate([theta, np.zeros(len(extra)), own]) / self.scale
        self.start = np.clip(start, self.low, self.high)
        self.best: Trial | None = None
        self.last: Trial | None = None
        self.solves = self.derivatives = 0
        self.measurements = 0.0
        self.failures: list[str] = []
        self.seconds = {"simulation": 0.0, "derivatives": 0.0, "objective": 0.0}
        self._known: tuple[DrapeResult, Sensitivities] | None = None

    def split(self, x: np.ndarray) -> tuple[np.ndarray, float, np.ndarray]:
        """theta (6,), log membrane stiffness, nuisances (K,) of x (n,)."""
        values = x * self.scale
        first = 7 if self._membrane else 6
        return values[:6], float(values[6]) if self._membrane else 0.0, values[first:]

    def value(self, x: np.ndarray) -> float:
        """The value at x (n,); infinite where no fabric or no equilibrium is."""
        theta, log_membrane, nuisance = self.split(x)
        drape = self._drape(theta, log_membrane)
        if drape is None:
            return math.inf
        residuals = self._timed("objective", self.objective.residuals, drape.positions, nuisance)
        total = value(residuals) + prior_value(self.prior, theta)
        self.last = Trial(np.array(x), theta, log_membrane, nuisance, drape, total)
        if math.isfinite(total) and (self.best is None or total < self.best.value):
            self.best = self.last
        return total

    def linearised(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        """Residuals (N,) and derivatives (N, n) at x (n,), the last or the best trial's."""
        trial = next((t for t in (self.last, self.best)
                      if t is not None and np.array_equal(t.x, x)), None)
        moves = None if trial is None else self._moves(trial)
        if moves is None:
            return None
        found = Linearised(*self._timed("objective", self.objective.linearised,
                                        trial.drape.positions, trial.nuisance))
        self.measurements = found.count
        began = time.perf_counter()
        jacobian = np.concatenate([found.along(moves), found.by_nuisance], axis=1)
        self.seconds["objective"] += time.perf_counter() - began
        residuals, jacobian = with_prior(
            self.prior, trial.theta, found.residuals, jacobian, np.eye(len(x))[:6])
        return residuals, jacobian * self.scale

    def _drape(self, theta: np.ndarray, log_membrane: float) -> DrapeResult | None:
        """The equilibrium of these moduli next to the best drape so far; None: no such thing."""
        for trial in (self.last, self.best):
            if trial is not None and np.array_equal(trial.theta, theta) and (
                    trial.log_membrane == log_membrane):
                return trial.drape  # only nuisances have changed
        drape, first = self._first
        # Not more than the rounding of x between them.
        if self.best is None and log_membrane == 0.0 and np.allclose(theta, first, 1e-12, 0.0):
            return drape if drape.converged else None
        if not is_admissible(*from_theta(theta)):
            return None
        near = self.origin or (drape if self.best is None else self.best.drape)
        self.solves += 1
        known = self._known[1] if self._known and self._known[0] is near else None
        new = self._timed("simulation", follow, near, fabric_from_theta(theta), keep=True,
                          laws=self._laws_at(log_membrane), extra=self._springs,
                          sensitivities=known)
        if not new.converged:
            self.failures.append(f"{new.status.value}: {new.message}")
            return None
        return new

    def _moves(self, trial: Trial) -> np.ndarray | None:
        """Derivatives (P, V, 3) of the vertices by theta and the membrane; None: there are none."""
        if self._known is None or self._known[0] is not trial.drape:
            self.derivatives += 1
            parameters = ("log_alpha", "ratio", *(["membrane"] if self._membrane else []))
            found = self._timed("derivatives", sensitivities, trial.drape, parameters=parameters)
            if not found.ok:
                self.failures.append(found.message)
            self._known = trial.drape, found
        return self._known[1].positions if self._known[1].ok else None

    def _laws_at(self, log_membrane: float) -> Laws:
        return self._laws.softened(math.exp(log_membrane)) if log_membrane else self._laws

    def _timed(self, what: str, function: Callable, *args: object, **more: object) -> object:
        began = time.perf_counter()
        try:
            return function(*args, **more)
        finally:
            self.seconds[what] += time.perf_counter() - began
