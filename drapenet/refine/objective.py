"""Objectives: comparisons of a simulated drape with a capture by half a sum of squared residuals.

They may have parameters, the nuisances, such as pose. For robustness the residuals themselves are
transformed (:func:`huber`); their number may vary between calls, but not their scale.
"""

from collections.abc import Callable
from typing import Annotated, NamedTuple, Protocol

import numpy as np

from common.types import Points
from drapenet.refine.minimise import Limits, minimise

NUISANCE_REACH = 20.0
"""Bounds of a nuisance around its start, in its scale."""

Moves = Annotated[np.ndarray, "(P, V, 3) moves of the vertices, m per unit of each parameter"]
Nuisance = Annotated[np.ndarray, "(M,) values of an objective's nuisances, SI"]
Residuals = Annotated[np.ndarray, "(R,) differences over their standard deviations"]


class Linearised(NamedTuple):
    """Residuals at one shape and their derivatives."""

    residuals: Residuals
    along: Callable[[Moves], np.ndarray]  # derivatives (N, P) along moves of the vertices
    by_nuisance: np.ndarray  # (N, K)
    independent: float  # measurements, below N: errors of neighbouring pixels are correlated


class Objective(Protocol):
    """A comparison of a simulated drape with a captured one."""

    nuisances: tuple[str, ...]  # their names
    start: Nuisance  # initial guess
    scale: Nuisance  # typical steps
    deviation: Nuisance  # prior standard deviations around the start; may be infinite

    def residuals(self, positions: Points, nuisance: Nuisance) -> Residuals:
        """Residuals of vertices at ``positions``."""

    def linearised(self, positions: Points, nuisance: Nuisance) -> Linearised:
        """Residuals and their derivatives."""


def value(residuals: Residuals) -> float:
    """Half the sum of squares."""
    return 0.5 * float(residuals @ residuals)


def huber(residuals: Residuals, limit: float) -> tuple[Residuals, np.ndarray]:
    """Residuals whose squares are linear beyond ``limit`` (Huber), and their derivatives (N,)."""
    size = np.abs(residuals)
    far = size > limit
    bent = np.sqrt(np.where(far, 2 * limit * size - limit**2, 1.0))
    return (np.where(far, np.sign(residuals) * bent, residuals),
            np.where(far, limit / bent, 1.0))


def fit_nuisances(objective: Objective, positions: Points, start: Nuisance) -> Nuisance:
    """Fit the nuisances to a fixed shape, without simulation."""
    if not len(start):
        return start
    problem = _FixedShape(objective, positions, start)
    return minimise(problem, limits=Limits(20, decrease=1e-3)).x * objective.scale


class _FixedShape:
    """Nuisances as unknowns, in their scales (:class:`.minimise.LeastSquares`)."""

    def __init__(self, objective: Objective, positions: Points, start: Nuisance) -> None:
        self._objective, self._positions = objective, positions
        self.start = start / objective.scale
        self.low, self.high = self.start - NUISANCE_REACH, self.start + NUISANCE_REACH

    def value(self, x: np.ndarray) -> float:
        return value(self._objective.residuals(self._positions, x * self._objective.scale))

    def linearised(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        scale = self._objective.scale
        linear = self._objective.linearised(self._positions, x * scale)
        return linear.residuals, linear.by_nuisance * scale
