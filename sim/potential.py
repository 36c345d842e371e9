"""The total energy of a cloth as a function of its free unknowns, for an optimiser."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numba
import numpy as np

from sim.energies.base import Energy, FramedEnergy, SeldomEnergy
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
        self._template = template
        self._free = np.flatnonzero(free)
        self._row = np.full(len(free), -1)
        self._row[self._free] = np.arange(len(self._free))
        self.size = len(self._free)
        self._stencils = [self._rows(energy.dofs) for energy in energies]
        self._framed = framed_energy(energies, free)
        self._here = _Here(np.empty(0), np.empty(0), self._usual_pattern)
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

    def hessian(self, y: np.ndarray, convexity: float) -> tuple[SparsePattern, np.ndarray]:
        """The Hessian by moves in the frames at ``y`` (see :meth:`into_frames`).

        What has been assembled at ``y`` is kept, so that another convexity there costs little.

        Args:
            convexity: as for :meth:`sim.energies.base.Energy.hessian`.

        Returns:
            A pattern and the CSR data (nnz,) in it. There are two patterns: the usual one, and one
            with the places of energies that are felt seldom.
        """
        here = self._look(y)
        total = np.zeros(len(here.pattern.indices))
        for stage, share in enumerate(stage_shares(convexity, self._stage[-1] + 1)):
            for end, weight in ((0.0, 1.0 - share), (1.0, share)):
                if weight > 0.0:
                    part = self._end(here, stage, end)
                    total += part if weight == 1.0 else weight * part
        return here.pattern, total

    def into_frames(self, y: np.ndarray, gradient: np.ndarray) -> np.ndarray:
        """Derivatives (n,) by moves in the frames of the edges at ``y``, from those by unknowns.

        The frames are those of :mod:`sim.energies.edge_frames`; without rotations, nothing changes.
        """
        if self._framed is None:
            return gradient
        return _into_frames(gradient, *self._frame_rows, self._levers(y))

    def out_of_frames(self, y: np.ndarray, move: np.ndarray) -> np.ndarray:
        """The move of the unknowns (n,) that is ``move`` (n,) in the frames at ``y``."""
        if self._framed is None:
            return move
        return _out_of_frames(move, *self._frame_rows, self._levers(y))

    def _look(self, y: np.ndarray) -> "_Here":
        """What is known at ``y``."""
        if not np.array_equal(y, self._here.y):
            q = self.full(y)
            felt = any(e.is_felt(q) for e in self.energies if isinstance(e, SeldomEnergy))
            pattern = self._whole_pattern if felt else self._usual_pattern
            self._here = _Here(y.copy(), q, pattern)
        return self._here

    def _end(self, here: "_Here", stage: int, convexity: float) -> np.ndarray:
        """One stage's part of the Hessian, exact (0) or convex (1)."""
        if (stage, convexity) not in here.assembled:
            # One after the other: blocks are large, and fresh memory is slow.
            here.assembled[stage, convexity] = here.pattern.assemble(
                self._blocks(energy, here.q, convexity) if own == stage else None
                for energy, own in zip(self.energies, self._stage, strict=True)
            )
        return here.assembled[stage, convexity]

    def _blocks(self, energy: Energy, q: np.ndarray, convexity: float) -> np.ndarray | None:
        return (energy.framed_hessian if energy is self._framed else energy.hessian)(q, convexity)

    def _levers(self, y: np.ndarray) -> np.ndarray:
        here = self._look(y)
        if here.levers is None:
            here.levers = self._framed.frames.levers(here.q)
        return here.levers

    @cached_property
    def _frame_rows(self) -> tuple[np.ndarray, np.ndarray]:
        """Rows (M, 12) and (M,) of the unknowns of the frames, -1 for held ones."""
        return self._rows(self._framed.frames.dofs), self._rows(self._framed.frames.rotations)

    @cached_property
    def _usual_pattern(self) -> SparsePattern:
        """Without the energies that are felt seldom, where these reach further than the others."""
        if self._framed is None:
            return self._whole_pattern
        return SparsePattern(
            [stencil[:0] if isinstance(energy, SeldomEnergy) else stencil
             for energy, stencil in zip(self.energies, self._hessian_stencils, strict=True)],
            self.size,
        )

    @cached_property
    def _whole_pattern(self) -> SparsePattern:
        return SparsePattern(self._hessian_stencils, self.size)

    @cached_property
    def _hessian_stencils(self) -> list[np.ndarray]:
        return [self._rows(energy.framed_dofs) if energy is self._framed else stencil
                for energy, stencil in zip(self.energies, self._stencils, strict=True)]

    def _rows(self, dofs: np.ndarray) -> np.ndarray:
        """The rows of unknowns, -1 for those that are held or absent."""
        return np.where(dofs >= 0, self._row[dofs], -1)

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


@dataclass
class _Here:
    """What is known of the Hessian at one point.

    Attributes:
        y, q: free and all unknowns there.
        pattern: of the Hessian.
        assembled: CSR data by stage and convexity.
        levers: of the frames, once they are asked for.
    """

    y: np.ndarray
    q: np.ndarray
    pattern: SparsePattern
    assembled: dict[tuple[int, float], np.ndarray] = field(default_factory=dict)
    levers: np.ndarray | None = None


def framed_energy(energies: Sequence[Energy], free: np.ndarray) -> FramedEnergy | None:
    """The one of the ``energies`` whose frames can be used; None where there is none.

    No other energy may depend on the rotations in its frames. These must be free, and what is
    beyond its clamped edges held. A law that has changed the plate's Hessian must have changed
    both forms of it.

    Args:
        energies: of one cloth.
        free: (Q,) bool, see :class:`Terms`.
    """
    for energy in energies:
        if not isinstance(energy, FramedEnergy):
            continue
        frames = energy.frames
        rotates = np.zeros(len(free) + 1, dtype=bool)  # one more, for dofs of -1
        rotates[frames.rotations] = True
        alone = not any(rotates[other.dofs].any() for other in energies if other is not energy)
        fits = free[frames.rotations].all() and not free[frames.clamped].any()
        own = _origin(energy, "hessian") is _origin(energy, "framed_hessian")
        return energy if alone and fits and own and len(frames.rotations) else None
    return None


def _origin(energy: Energy, method: str) -> type:
    """The class that defines a method of an energy."""
    return next(kind for kind in type(energy).__mro__ if method in vars(kind))


@numba.njit(cache=True)
def _into_frames(gradient, corners, rotations, levers):
    result = gradient.copy()
    for e in range(len(rotations)):
        torque = gradient[rotations[e]]
        for k in range(corners.shape[1]):
            if corners[e, k] >= 0:
                result[corners[e, k]] += levers[e, k] * torque
    return result


@numba.njit(cache=True)
def _out_of_frames(move, corners, rotations, levers):
    result = move.copy()
    for e in range(len(rotations)):
        for k in range(corners.shape[1]):
            if corners[e, k] >= 0:
                result[rotations[e]] += levers[e, k] * move[corners[e, k]]
    return result


@numba.njit(cache=True)
def _add_elements(total, stencil, parts):
    """Add element gradients (N, K) to total (n,); stencil (N, K) as for the pattern."""
    for t in range(len(stencil)):
        for k in range(stencil.shape[1]):
            if stencil[t, k] >= 0:
                total[stencil[t, k]] += parts[t, k]
