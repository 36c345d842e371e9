"""Interface of the objectives of a refinement.

An objective compares a simulated drape, given by its vertex positions, with a capture. It does not
depend on the moduli; it may have further parameters, the nuisances, such as orientation and pose.
Its value is half the sum of squared residuals. For robustness to outliers the residuals themselves
are transformed (:func:`huber`), so that every optimiser solves a plain least-squares problem.

The number of residuals may vary between calls (pixels that show cloth), but not their scale,
because values of different calls are compared.
"""

from collections.abc import Callable
from typing import NamedTuple, Protocol

import numpy as np

from drapenet.refine.minimise import Limits, minimise

NUISANCE_REACH = 20.0
"""Bounds of a nuisance around its start, in its scale."""

Along = Callable[[np.ndarray], np.ndarray]
"""From moves of the vertices (P, V, 3), m per unit of each parameter, to the derivatives of the
residuals along them (N, P)."""


class Linearised(NamedTuple):
    """Residuals at one shape and their derivatives.

    Attributes:
        residuals: (N,) without unit: divided by their standard deviations.
        along: their derivatives along moves of the vertices, see :data:`Along`.
        by_nuisance: (N, K) their derivatives by the objective's own parameters.
        independent: number of independent measurements; smaller than N, because errors of
            neighbouring pixels are correlated.
    """

    residuals: np.ndarray
    along: Along
    by_nuisance: np.ndarray
    independent: float


class Objective(Protocol):
    """A comparison of a simulated drape with a captured one.

    Attributes:
        nuisances: names of its K further parameters.
        start: (K,) their initial guess, SI.
        scale: (K,) typical step of each.
        deviation: (K,) prior standard deviation of each around its start; infinite without a prior.
    """

    nuisances: tuple[str, ...]
    start: np.ndarray
    scale: np.ndarray
    deviation: np.ndarray

    def residuals(self, positions: np.ndarray, nuisance: np.ndarray) -> np.ndarray:
        """Residuals (N,) of vertices at positions (V, 3), m, and nuisances (K,)."""

    def linearised(self, positions: np.ndarray, nuisance: np.ndarray) -> Linearised:
        """Residuals and their derivatives."""


def value(residuals: np.ndarray) -> float:
    """Half the sum of the squares of residuals (N,)."""
    return 0.5 * float(residuals @ residuals)


def huber(residuals: np.ndarray, limit: float) -> tuple[np.ndarray, np.ndarray]:
    """Residuals whose squares grow linearly beyond ``limit``, and their derivatives, both (N,).

    Half of their squares is Huber's function of the residuals given.
    """
    size = np.abs(residuals)
    far = size > limit
    bent = np.sqrt(np.where(far, 2 * limit * size - limit**2, 1.0))
    return (np.where(far, np.sign(residuals) * bent, residuals),
            np.where(far, limit / bent, 1.0))


def fit_nuisances(
    objective: Objective, positions: np.ndarray, start: np.ndarray, *, evaluations: int = 20
) -> np.ndarray:
    """Fit the nuisances (K,) to a fixed shape (V, 3), m, from ``start`` (K,), without simulation.
    """
    if not len(start):
        return start
    outcome = minimise(_FixedShape(objective, positions, start), limits=Limits(
        evaluations=evaluations, decrease=1e-3))
    return outcome.x * objective.scale


class _FixedShape:
    """Nuisances as unknowns, in their scales (:class:`.optimisers.LeastSquares`)."""

    def __init__(self, objective: Objective, positions: np.ndarray, start: np.ndarray) -> None:
        self._objective, self._positions = objective, positions
        self.start = start / objective.scale
        self.low, self.high = self.start - NUISANCE_REACH, self.start + NUISANCE_REACH

    def value(self, x: np.ndarray) -> float:
        scaled = x * self._objective.scale
        return value(self._objective.residuals(self._positions, scaled))

    def linearised(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        scale = self._objective.scale
        found = self._objective.linearised(self._positions, x * scale)
        return found.residuals, found.by_nuisance * scale
