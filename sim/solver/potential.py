"""The total energy of a cloth as a function of its free unknowns, for the minimisation."""

from collections.abc import Sequence
from functools import cached_property

import numba
import numpy as np

from common.types import Edges
from sim.energies.base import Energy, StateCache
from sim.solver.linear import SparsePattern
from sim.solver.state import moved


class Potential:
    """A sum of energies, with derivatives by a step (n,) of the free ones among U unknowns.

    Args:
        stages: groups of energies that are made convex one after the other: with two groups,
            convexity 1/2 means the first group convex and the second exact.
        edges: those whose normals are part of the state.
        free: (U,) bool, unknowns that may change.
        force_scale: (U,) units of residuals (N, or N·m for rotations).
        length_scale: (U,) units of step lengths and regularisation (m or rad).
        energy_scale: J, magnitude of the energy's change when the cloth falls.
    """

    def __init__(
        self, stages: Sequence[Sequence[Energy]], edges: Edges, free: np.ndarray, *,
        force_scale: np.ndarray, length_scale: np.ndarray, energy_scale: float
    ) -> None:
        self.energies = [energy for stage in stages for energy in stage]
        self._stage = np.repeat(np.arange(len(stages)), [len(stage) for stage in stages])
        self._edges, self._free = edges, np.flatnonzero(free)
        self.unknowns, self.size = len(free), len(self._free)
        self._force_scale, self._length_scale = force_scale[self._free], length_scale[self._free]
        self.regularisation = self._force_scale / self._length_scale
        self.energy_scale = energy_scale
        self._parts = StateCache(states=1)

    def all_unknowns(self, step: np.ndarray) -> np.ndarray:
        """Step (U,) of all unknowns from that of the free ones (n,), zero for the others."""
        full = np.zeros(self.unknowns)
        full[self._free] = step
        return full

    def free_unknowns(self, values: np.ndarray) -> np.ndarray:
        """Entries (n,) of values (U,) that belong to free unknowns."""
        return values[self._free]

    def moved(self, q: np.ndarray, step: np.ndarray) -> np.ndarray:
        """The state after a step (n,) from the state ``q``."""
        return moved(q, self._edges, self.all_unknowns(step))

    def value(self, q: np.ndarray) -> float:
        """Energy, J."""
        return sum(energy.value(q) for energy in self.energies)

    def gradient(self, q: np.ndarray) -> np.ndarray:
        """(n,) derivative of the energy by a step."""
        return self.free_unknowns(forces(self.energies, q, self.unknowns))

    @cached_property
    def pattern(self) -> SparsePattern:
        """Sparsity pattern of the Hessian."""
        row = np.full(self.unknowns + 1, -1)  # last entry: dofs of -1
        row[self._free] = np.arange(self.size)
        return SparsePattern([row[energy.dofs] for energy in self.energies], self.size)

    def hessian(self, q: np.ndarray, convexity: float = 0.0, shift: float = 0.0) -> np.ndarray:
        """CSR data (nnz,) of the Hessian in :attr:`pattern`, plus ``shift`` times
        :attr:`regularisation` on the diagonal. With ``convexity`` from 0 (exact) to 1, stages
        become convex one after the other, each by interpolation of its two forms."""
        total = np.zeros(len(self.pattern.indices))
        stages = self._stage[-1] + 1
        for stage in range(stages):
            share = min(max(convexity * stages - stage, 0.0), 1.0)
            for convex, weight in ((False, 1.0 - share), (True, share)):
                if weight > 0.0:
                    part = self._part(q, stage, convex)
                    total += part if weight == 1.0 else weight * part
        if shift:
            total[self.pattern.diagonal] += shift * self.regularisation
        return total

    def _part(self, q: np.ndarray, stage: int, convex: bool) -> np.ndarray:
        """One stage's part of the Hessian, cached for other convexities at the same state."""
        parts = self._parts.at(q, lambda q: {})
        if (stage, convex) not in parts:
            # Sequentially: blocks are large, and allocating memory for all of them is slow.
            parts[stage, convex] = self.pattern.assemble(
                energy.hessian(q, convex) if own == stage else None
                for energy, own in zip(self.energies, self._stage, strict=True)
            )
        return parts[stage, convex]

    def allows(self, old: np.ndarray, new: np.ndarray) -> bool:
        """Whether every energy allows the step between two states."""
        return all(energy.allows(old, new) for energy in self.energies)

    def residual(self, gradient: np.ndarray) -> float:
        """Largest entry of a gradient (n,) in units of its force scale."""
        return float(np.abs(gradient / self._force_scale).max())

    def step_length(self, step: np.ndarray) -> float:
        """Largest entry of a step (n,) in units of its length scale."""
        return float(np.abs(step / self._length_scale).max())


def forces(energies: Sequence[Energy], q: np.ndarray, size: int) -> np.ndarray:
    """(U,) derivatives of a sum of energies by all U = ``size`` unknowns."""
    total = np.zeros(size)
    for energy in energies:
        _add_elements(total, energy.dofs, energy.gradient(q))
    return total


@numba.njit(cache=True)
def _add_elements(total, dofs, parts):
    """Add the elements' contributions ``parts`` (N, K) to total (U,)."""
    for t in range(len(dofs)):
        for k in range(dofs.shape[1]):
            if dofs[t, k] >= 0:
                total[dofs[t, k]] += parts[t, k]
