"""How far each sample of a batch goes along its step."""

import numpy as np
import torch

from sim.batched.objective import BatchedObjective, on_device, on_host, part_of
from sim.newton import NOISE, SMALLEST_STEP, SUFFICIENT


class LineSearch:
    """Step lengths by backtracking from 1, doubling while the energy keeps falling.

    Attributes:
        length: (b,) found, 0 where none is.
        best, lowest: (b, n) points found and (b,) their values, the old ones where none is.
    """

    def __init__(
        self,
        objective: BatchedObjective,
        y: torch.Tensor,
        step: torch.Tensor,
        value: np.ndarray,
        gradient: torch.Tensor,
        residual: np.ndarray,
    ) -> None:
        self.objective, self.y, self.move = objective, y, step
        self.value, self.residual = value, residual
        self.slope = on_host((gradient * step).sum(dim=1))
        self.length = np.zeros(len(value))
        self.best, self.lowest = y.clone(), value.copy()

    def run(self) -> None:
        """Find the lengths."""
        pending = np.flatnonzero(self.slope < 0)
        length, drowned = np.ones(len(self.value)), np.zeros(len(self.value), dtype=bool)
        while len(pending):
            trial, allowed, value = self._try(pending, length[pending])
            fall = length[pending] * self.slope[pending]
            good = allowed & (value <= self.value[pending] + SUFFICIENT * fall)
            noise = NOISE * np.abs(self.value[pending])
            # Energies differ by rounding only: let the gradient decide.
            unclear = allowed & ~good & (np.abs(fall) < noise)
            unclear &= value < self.value[pending] + noise
            better = self._has_less_residual(pending, np.flatnonzero(unclear), trial)
            drowned[pending[better]] = True
            good[better] = True
            self._keep(pending, good, trial, length, value)
            pending = pending[~good]
            length[pending] /= 2
            pending = pending[length[pending] > SMALLEST_STEP]
        pending = np.flatnonzero((self.length >= 1.0) & ~drowned)
        while len(pending):
            length[pending] = 2 * self.length[pending]
            trial, allowed, value = self._try(pending, length[pending])
            bound = self.value[pending] + SUFFICIENT * length[pending] * self.slope[pending]
            good = allowed & (value < np.minimum(self.lowest[pending], bound))
            self._keep(pending, good, trial, length, value)
            pending = pending[good]

    def _try(
        self, index: np.ndarray, length: np.ndarray
    ) -> tuple[torch.Tensor, np.ndarray, np.ndarray]:
        """Points (b, n), whether the steps there are allowed (b,), and values (b,)."""
        objective, at = part_of(self.objective, index, self.y), self._at(index)
        old = self.y[at]
        trial = old + on_device(length, old)[:, None] * self.move[at]
        return trial, on_host(objective.allows(old, trial)), on_host(objective.value(trial))

    def _has_less_residual(
        self, pending: np.ndarray, which: np.ndarray, trial: torch.Tensor
    ) -> np.ndarray:
        """Those of the trials ``which`` whose gradient is smaller than the one at the start."""
        if not len(which):
            return which
        objective = part_of(self.objective, pending[which], self.y)
        residual = on_host(objective.residual(objective.gradient(trial[self._at(which)])))
        return which[residual < self.residual[pending[which]]]

    def _keep(
        self,
        pending: np.ndarray,
        good: np.ndarray,
        trial: torch.Tensor,
        length: np.ndarray,
        value: np.ndarray,
    ) -> None:
        """The ``good`` ones of the trials are the best so far."""
        found = pending[good]
        self.best[self._at(found)] = trial[self._at(np.flatnonzero(good))]
        self.length[found], self.lowest[found] = length[found], value[good]

    def _at(self, index: np.ndarray) -> torch.Tensor:
        return on_device(index, self.y)
