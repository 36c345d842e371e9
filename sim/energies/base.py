"""Interface of an energy, its check by differences, and what several energies use."""

from abc import abstractmethod
from typing import Protocol

import numba
import numpy as np

from common.errors import InputError
from common.types import Edges, StateVector
from sim.solver.linear import SparsePattern, add_blocks, make_solver
from sim.solver.state import moved

STEP = 3e-8  # m, or rad
TOLERANCE = 1e-4  # relative to the magnitude of the terms
DIRECTIONS = 8


class Energy(Protocol):
    """A sum over elements, each a function of a few of the unknowns. Only sums over all elements
    must be derivatives of each other, as an element's share of the energy is not unique.

    Unknowns are the coordinates of the vertices (m), three per vertex, then the rotation of every
    edge normal (rad): 3 V + E. Derivatives are with respect to a step of them from a state ``q``
    (:mod:`sim.solver.state`). They include held coordinates, so that energies need not know which
    ones are free. User-defined energies enter a drape by :attr:`sim.cloth.Laws.others`
    (docs/extending.md) and derive from this class.

    An energy is constant: what changes between minimisations, such as the origins of hysteresis or
    the aim of a time step, makes another energy with the same ``dofs``, which takes its place in a
    potential (:meth:`sim.solver.potential.Potential.exchanged`).

    Attributes:
        dofs: (N, K) int64, unknowns of each of the N elements; -1 marks an absent one, whose
            gradient and Hessian entries are ignored.
    """

    dofs: np.ndarray

    def value(self, q: StateVector) -> float:
        """Energy, J."""

    def gradient(self, q: StateVector) -> np.ndarray:
        """Derivatives (N, K) of each element's energy by its unknowns."""

    def hessian(self, q: StateVector, convex: bool = False) -> np.ndarray | None:
        """Second derivatives (N, K, K) of each element's energy, or None if all are zero; with
        ``convex``, a positive semi-definite approximation."""

    def allows(self, old: StateVector, new: StateVector) -> bool:
        """Whether a step from ``old`` to ``new`` stays on one branch of the energy."""
        return True

    def add_forces(self, q: StateVector, forces: np.ndarray) -> float:
        """Add the gradient to ``forces`` (U,), in the order of all unknowns; return the energy."""
        add_elements(forces, self.dofs, self.gradient(q))
        return self.value(q)

    def add_stiffness(
        self, q: StateVector, slots: np.ndarray, exact: np.ndarray, convex: np.ndarray
    ) -> None:
        """Add the Hessian to the data of sparse matrices: the blocks' upper triangles, row by row,
        at ``slots`` (N, K(K+1)/2), -1: nowhere. ``exact`` or ``convex`` is empty if not wanted."""
        for data, is_convex in ((exact, False), (convex, True)):
            blocks = self.hessian(q, is_convex) if len(data) else None
            if blocks is not None:
                add_blocks(data, slots, blocks)


class FusedEnergy(Energy):
    """An energy whose value and gradient come from one evaluation, which adds them where they
    belong. Its Hessian is given by ``add_stiffness``, or by ``hessian``, each by the other."""

    @abstractmethod
    def _add_forces(self, q: StateVector, targets: np.ndarray, forces: np.ndarray) -> float:
        """Energy; its derivatives are added to the entries ``targets`` (N, K) of ``forces``."""

    def add_forces(self, q: StateVector, forces: np.ndarray) -> float:
        return self._add_forces(q, self.dofs, forces)

    def value(self, q: StateVector) -> float:
        return self.add_forces(q, np.zeros(self.dofs.max(initial=0) + 1))

    def gradient(self, q: StateVector) -> np.ndarray:
        result = np.zeros(self.dofs.size)
        self._add_forces(q, np.arange(self.dofs.size).reshape(self.dofs.shape), result)
        return result.reshape(self.dofs.shape)

    def hessian(self, q: StateVector, convex: bool = False) -> np.ndarray:
        count, size = self.dofs.shape
        i, j = np.triu_indices(size)
        data, none = np.zeros(count * len(i)), np.zeros(0)
        slots = np.arange(len(data), dtype=np.int32).reshape(count, -1)
        self.add_stiffness(q, slots, *((none, data) if convex else (data, none)))
        result = np.empty((count, size, size))
        result[:, i, j] = result[:, j, i] = data.reshape(count, -1)
        return result


def dofs_of(energy: Energy) -> np.ndarray:
    """The ``dofs`` (N, K) of an energy; InputError if they are missing or have another form."""
    dofs = np.asarray(getattr(energy, "dofs", None))
    if dofs.ndim != 2 or not np.issubdtype(dofs.dtype, np.integer):
        raise InputError(f"{type(energy).__name__}.dofs must be an array (N, K) of integers: the "
                         "unknowns that each element depends on (sim.energies.base.Energy)")
    return dofs


@numba.njit(cache=True)
def add_elements(total, dofs, parts):
    """Add the elements' contributions ``parts`` (N, K) to total (U,)."""
    for t in range(len(dofs)):
        for k in range(dofs.shape[1]):
            if dofs[t, k] >= 0:
                total[dofs[t, k]] += parts[t, k]


@numba.njit(cache=True)
def raise_eigenvalues(matrices, floor):
    """Raise eigenvalues of symmetric matrices (N, 3, 3) to at least ``floor``, in place."""
    for matrix in matrices:
        # Positive pivots of matrix - floor: most matrices need no eigenvectors.
        first = matrix[0, 0] - floor
        second = (matrix[1, 1] - floor) * first - matrix[0, 1] ** 2
        if first > 0.0 and second > 0.0:
            cross = matrix[1, 2] * first - matrix[0, 1] * matrix[0, 2]
            if ((matrix[2, 2] - floor) * first - matrix[0, 2] ** 2) * second > cross * cross:
                continue
        value, vector = np.linalg.eigh(matrix)
        for k in range(3):
            if value[k] < floor:
                for i in range(3):
                    for j in range(3):
                        matrix[i, j] += (floor - value[k]) * vector[i, k] * vector[j, k]


def check(energy: Energy, q: StateVector, edges: Edges, *, seed: int = 0) -> None:
    """Compare gradient and Hessian with differences of value and gradient along random steps, at a
    state with non-zero energy. InputError if ``dofs`` have another form, a derivative deviates
    from the differences, or the convex Hessian is not positive semi-definite."""
    name, dofs = type(energy).__name__, dofs_of(energy)
    if not energy.value(q):
        raise InputError(f"{name} is 0 at this state, where nothing can be compared; give a state "
                         "in which it acts")
    unknowns, rng = len(q) - 2 * len(edges), np.random.default_rng(seed)
    if dofs.max(initial=-1) >= unknowns:
        raise InputError(f"{name}.dofs: {dofs.max()} is beyond the {unknowns} unknowns")
    gradient = energy.gradient(q)
    if np.shape(gradient) != dofs.shape:
        raise InputError(f"{name}.gradient has the shape {np.shape(gradient)}; it must have "
                         f"that of {name}.dofs, {dofs.shape}")
    pattern = SparsePattern([dofs], unknowns)
    full, convex = np.zeros((2, len(pattern.indices)))
    energy.add_stiffness(q, pattern.slots[0], full, convex)
    matrix = pattern.symmetric(full)
    for _ in range(DIRECTIONS):
        step = rng.standard_normal(unknowns)
        local = np.where(dofs >= 0, step[dofs], 0.0)  # (N, K)
        ahead, behind = (moved(q, edges, sign * STEP * step) for sign in (1.0, -1.0))
        rounding = 1e-15 * abs(energy.value(q)) / STEP
        _compare(f"{name}.gradient", "value", (gradient * local).sum(),
                 (energy.value(ahead) - energy.value(behind)) / (2 * STEP),
                 np.abs(gradient * local).sum(), rounding)
        slopes, back = np.zeros((2, unknowns))
        energy.add_forces(ahead, slopes)
        energy.add_forces(behind, back)
        rounding = 1e-15 * np.abs(gradient).max(initial=0.0) / STEP
        # The symmetric part alone: rotations of normals about turning edges do not commute.
        _compare(f"{name}.hessian", "gradient", step @ (matrix @ step),
                 float(step @ (slopes - back)) / (2 * STEP),
                 np.abs(step) @ (abs(matrix) @ np.abs(step)), rounding * np.abs(step).sum())
    convex[pattern.diagonal] += 1e-9 * np.abs(convex).max(initial=1e-300)
    if not make_solver(pattern).factorise(convex):
        raise InputError(f"{name}.hessian(q, convex=True) has a negative eigenvalue; it must be "
                         "positive semi-definite")


def _compare(
    name: str, of: str, derivative: float, difference: float, size: float, rounding: float
) -> None:
    if not abs(derivative - difference) <= TOLERANCE * size + 100 * rounding:
        raise InputError(f"{name} is not the derivative of the {of}: along a random step it gives "
                         f"{derivative:.4g}, differences give {difference:.4g}")
