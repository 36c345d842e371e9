"""The total energy of a cloth as a function of its free unknowns, for an optimiser."""

from collections.abc import Sequence
from dataclasses import dataclass

import numba
import numpy as np

from sim.energies.base import Energy
from sim.linear import SparsePattern


@dataclass(frozen=True)
class Terms:
    """What a potential consists of.

    Attributes:
        stages: the energies, in groups that are made convex one after the other: with two of
            them, a convexity of 1/2 stands for the first group convex and the second exact.
        template: (Q,) unknowns; entries that are not free keep these values.
        free: (Q,) bool.
        force_scale: (Q,) forces (N, or N·m for rotations) that count as 1 in residuals.
        length_scale: (Q,) moves (m or rad) that count as 1 in step lengths and
            regularisation.
    """

    stages: Sequence[Sequence[Energy]]
    template: np.ndarray
    free: np.ndarray
    force_scale: np.ndarray
    length_scale: np.ndarray


def stage_shares(convexity: float, stages: int) -> list[float]:
    """How convex each of the ``stages`` groups of :class:`Terms` is, in [0, 1]."""
    return [min(max(convexity * stages - stage, 0.0), 1.0) for stage in range(stages)]


class Potential:
    """A sum of energies over the free entries of the unknowns ``q`` (see :class:`Energy`).

    The arguments are the attributes of :class:`Terms`.
    """

    def __init__(
        self,
        stages: Sequence[Sequence[Energy]],
        *,
        template: np.ndarray,
        free: np.ndarray,
        force_scale: np.ndarray,
        length_scale: np.ndarray,
    ) -> None:
        self.energies = energies = [energy for stage in stages for energy in stage]
        self._stage = np.repeat(np.arange(len(stages)), [len(stage) for stage in stages])
        self._assembled_at: np.ndarray | None = None
        self._assembled: dict[tuple[int, float], np.ndarray] = {}
        self._template = template
        self._free = np.flatnonzero(free)
        row = np.full(len(free), -1)
        row[self._free] = np.arange(len(self._free))
        self._stencils = [
            np.where(energy.dofs >= 0, row[energy.dofs], -1) for energy in energies
        ]
        self.size = len(self._free)
        self.pattern = SparsePattern(self._stencils, self.size)
        self._force_scale = force_scale[self._free]
        self.length_scale = length_scale[self._free]
        self.regularisation = self._force_scale / self.length_scale

    def full(self, y: np.ndarray) -> np.ndarray:
        """All unknowns (Q,) from the free ones (n,)."""
        q = self._template.copy()
        q[self._free] = y
        return q

    def free_part(self, q: np.ndarray) -> np.ndarray:
        """The free unknowns (n,) of all (Q,)."""
        return q[self._free]

    def value(self, y: np.ndarray) -> float:
        """Energy, J."""
        q = self.full(y)
        return sum(energy.value(q) for energy in self.energies)

    def gradient(self, y: np.ndarray) -> np.ndarray:
        """(n,) derivative of the energy."""
        q = self.full(y)
        total = np.zeros(self.size)
        for energy, stencil in zip(self.energies, self._stencils, strict=True):
            _add_elements(total, stencil, energy.gradient(q))
        return total

    def hessian(self, y: np.ndarray, convexity: float) -> np.ndarray:
        """CSR data (nnz,) in ``pattern``; ``convexity`` as in :meth:`Energy.hessian`.

        What has been assembled at ``y`` is kept, so that another convexity there costs little.
        """
        if self._assembled_at is None or not np.array_equal(y, self._assembled_at):
            self._assembled_at = y.copy()
            self._assembled.clear()
        stages = self._stage[-1] + 1
        total = np.zeros(len(self.pattern.indices))
        for stage, share in enumerate(stage_shares(convexity, stages)):
            for end, weight in ((0.0, 1.0 - share), (1.0, share)):
                if weight > 0.0:
                    part = self._end(stage, end)
                    total += part if weight == 1.0 else weight * part
        return total

    def _end(self, stage: int, convexity: float) -> np.ndarray:
        """One stage's part of the Hessian at the kept point, exact (0) or convex (1)."""
        if (stage, convexity) not in self._assembled:
            q = self.full(self._assembled_at)
            # One after the other: blocks are large, and fresh memory is slow.
            self._assembled[stage, convexity] = self.pattern.assemble(
                energy.hessian(q, convexity) if own == stage else None
                for energy, own in zip(self.energies, self._stage, strict=True)
            )
        return self._assembled[stage, convexity]

    def allows(self, old: np.ndarray, new: np.ndarray) -> bool:
        """Whether every energy allows the step between free unknowns (n,)."""
        old, new = self.full(old), self.full(new)
        return all(energy.allows(old, new) for energy in self.energies)

    def residual(self, gradient: np.ndarray) -> float:
        """Largest entry of a gradient (n,) in units of its force scale."""
        return float(np.abs(gradient / self._force_scale).max())

    def step_length(self, step: np.ndarray) -> float:
        """Largest entry of a step (n,) in units of its length scale."""
        return float(np.abs(step / self.length_scale).max())


@numba.njit(cache=True)
def _add_elements(total, stencil, parts):
    """Add element gradients (N, K) to total (n,); stencil (N, K) as for the pattern."""
    for t in range(len(stencil)):
        for k in range(stencil.shape[1]):
            if stencil[t, k] >= 0:
                total[stencil[t, k]] += parts[t, k]
