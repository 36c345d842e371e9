"""The total energy of a cloth as a function of its free unknowns, for the minimisation."""

import copy
from collections.abc import Mapping, Sequence
from functools import cached_property

import numpy as np

from common.types import Edges
from sim.energies.base import Energy
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

    Attributes:
        energies, stage_of: all energies, and the stage of each among :attr:`stages` of them.
        free: (n,) indices of the free unknowns.
        unknowns, size: the numbers U and n.
        regularisation: (n,) stiffness of a unit of force per unit of length.
    """

    def __init__(
        self, stages: Sequence[Sequence[Energy]], edges: Edges, free: np.ndarray, *,
        force_scale: np.ndarray, length_scale: np.ndarray, energy_scale: float
    ) -> None:
        self.energies = [energy for stage in stages for energy in stage]
        self.stages = len(stages)
        self.stage_of = np.repeat(np.arange(len(stages)), [len(stage) for stage in stages])
        self._edges, self.free = edges, np.flatnonzero(free)
        self.unknowns, self.size = len(free), len(self.free)
        self._force_scale, self._length_scale = force_scale[self.free], length_scale[self.free]
        self.regularisation = self._force_scale / self._length_scale
        self.energy_scale = energy_scale

    def all_unknowns(self, step: np.ndarray) -> np.ndarray:
        """Step (U,) of all unknowns from that of the free ones (n,), zero for the others."""
        full = np.zeros(self.unknowns)
        full[self.free] = step
        return full

    def free_unknowns(self, values: np.ndarray) -> np.ndarray:
        """Entries (n,) of values (U,) that belong to free unknowns."""
        return values[self.free]

    def moved(self, q: np.ndarray, step: np.ndarray) -> np.ndarray:
        """The state after a step (n,) from the state ``q``."""
        return moved(q, self._edges, self.all_unknowns(step))

    def evaluate(self, q: np.ndarray) -> tuple[float, np.ndarray]:
        """Energy, J, and its derivative (n,) by a step."""
        forces = np.zeros(self.unknowns)
        value = sum(energy.add_forces(q, forces) for energy in self.energies)
        return value, self.free_unknowns(forces)

    def value(self, q: np.ndarray) -> float:
        """Energy, J."""
        return self.evaluate(q)[0]

    def gradient(self, q: np.ndarray) -> np.ndarray:
        """(n,) derivative of the energy by a step."""
        return self.evaluate(q)[1]

    @cached_property
    def pattern(self) -> SparsePattern:
        """Sparsity pattern of the Hessian."""
        row = np.full(self.unknowns + 1, -1)  # last entry: dofs of -1
        row[self.free] = np.arange(self.size)
        return SparsePattern([row[energy.dofs] for energy in self.energies], self.size)

    def exchanged(self, changes: Mapping[Energy, Energy]) -> "Potential":
        """A copy with other energies, which have the same ``dofs``, in the places of the keys of
        ``changes``; it shares all else, the pattern included."""
        _ = self.pattern  # computed once, not for each copy
        other = copy.copy(self)
        other.energies = [changes.get(energy, energy) for energy in self.energies]
        return other

    def model(self, q: np.ndarray) -> "QuadraticModel":
        """The Hessian at the state ``q`` and its convex approximations."""
        return QuadraticModel(self, q)

    def allows(self, old: np.ndarray, new: np.ndarray) -> bool:
        """Whether every energy allows the step between two states."""
        return all(energy.allows(old, new) for energy in self.energies)

    def residual(self, gradient: np.ndarray) -> float:
        """Largest entry of a gradient (n,) in units of its force scale."""
        return float(np.abs(gradient / self._force_scale).max())

    def step_length(self, step: np.ndarray) -> float:
        """Largest entry of a step (n,) in units of its length scale."""
        return float(np.abs(step / self._length_scale).max())


class QuadraticModel:
    """The Hessian of a ``potential`` at the state ``q``, and its blends with a convex form. Each of
    the two is assembled when it is first needed."""

    def __init__(self, potential: Potential, q: np.ndarray) -> None:
        self._potential, self._q = potential, q
        self._parts: dict[bool, np.ndarray] = {}  # (stages, nnz) by whether they are convex

    def hessian(self, convexity: float = 0.0, shift: float = 0.0) -> np.ndarray:
        """CSR data (nnz,) in the potential's pattern, plus ``shift`` times its regularisation on
        the diagonal. With ``convexity`` from 0 (exact) to 1, stages become convex one after the
        other, each by interpolation of its two forms."""
        potential = self._potential
        stages = range(potential.stages)
        shares = np.clip(convexity * potential.stages - np.array(stages), 0.0, 1.0)
        weights = {False: 1.0 - shares, True: shares}
        self._assemble({convex for convex in weights if weights[convex].any()})
        total = sum(weights[convex][stage] * self._parts[convex][stage]
                    for stage in stages for convex in weights if weights[convex][stage] > 0.0)
        if shift:
            total[potential.pattern.diagonal] += shift * potential.regularisation
        return total

    def _assemble(self, wanted: set[bool]) -> None:
        pattern, missing = self._potential.pattern, wanted - self._parts.keys()
        if not missing:
            return
        none = np.zeros(0)
        for convex in missing:
            self._parts[convex] = np.zeros((self._potential.stages, len(pattern.indices)))
        for energy, stage, slots in zip(self._potential.energies, self._potential.stage_of,
                                        pattern.slots, strict=True):
            energy.add_stiffness(self._q, slots, *(
                self._parts[convex][stage] if convex in missing else none
                for convex in (False, True)))


def forces(energies: Sequence[Energy], q: np.ndarray, size: int) -> np.ndarray:
    """(U,) derivatives of a sum of energies by all U = ``size`` unknowns."""
    total = np.zeros(size)
    for energy in energies:
        energy.add_forces(q, total)
    return total
