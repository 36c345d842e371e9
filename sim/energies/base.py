"""Interface of an energy, its check by differences, and what several energies use."""

from collections.abc import Callable
from typing import Protocol, TypeVar

import numba
import numpy as np

from common.errors import InputError
from common.types import Edges, StateVector
from sim.solver.state import moved

STEP = 1e-7  # m, or rad
TOLERANCE = 1e-4  # relative to the magnitude of the terms
DIRECTIONS = 3
T = TypeVar("T")


class Energy(Protocol):
    """A sum over elements, each a function of a few of the unknowns.

    Unknowns are the coordinates of the vertices (m), three per vertex, then the rotation of every
    edge normal (rad): 3 V + E. Derivatives are with respect to a step of them from a state ``q``
    (:mod:`sim.solver.state`). They include held coordinates, so that energies need not know which
    ones are free. User-defined energies enter a drape by :attr:`sim.cloth.Laws.others`
    (docs/extending.md) and derive from this class.

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


def dofs_of(energy: Energy) -> np.ndarray:
    """The ``dofs`` (N, K) of an energy; InputError if they are missing or have another form."""
    dofs = np.asarray(getattr(energy, "dofs", None))
    if dofs.ndim != 2 or not np.issubdtype(dofs.dtype, np.integer):
        raise InputError(f"{type(energy).__name__}.dofs must be an array (N, K) of integers: the "
                         "unknowns that each element depends on (sim.energies.base.Energy)")
    return dofs


class StateCache:
    """Results of one function at the latest states: two hold the start of a Newton step and the
    trial state, where value, gradient and Hessian are evaluated one after the other."""

    def __init__(self, states: int = 2) -> None:
        self._states = states
        self._latest: list[tuple[np.ndarray, object]] = []

    def at(self, q: StateVector, function: Callable[[StateVector], T]) -> T:
        """``function(q)``, cached or computed; ``function`` must be the same in all calls."""
        for state, value in self._latest:
            if np.array_equal(state, q):
                return value
        value = function(q)
        self._latest = [(q.copy(), value), *self._latest[: self._states - 1]]
        return value


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
    unknowns, rng = len(q) - 2 * len(edges), np.random.default_rng(seed)
    if dofs.max(initial=-1) >= unknowns:
        raise InputError(f"{name}.dofs: {dofs.max()} is beyond the {unknowns} unknowns")
    gradient = energy.gradient(q)
    if np.shape(gradient) != dofs.shape:
        raise InputError(f"{name}.gradient has the shape {np.shape(gradient)}; it must have "
                         f"that of {name}.dofs, {dofs.shape}")
    full, convex = (np.zeros((*dofs.shape, dofs.shape[1])) if hessian is None else hessian
                    for hessian in (energy.hessian(q), energy.hessian(q, convex=True)))
    for _ in range(DIRECTIONS):
        step = rng.standard_normal(unknowns)
        local = np.where(dofs >= 0, step[dofs], 0.0)  # (N, K)
        ahead, behind = (moved(q, edges, sign * STEP * step) for sign in (1.0, -1.0))
        rounding = 1e-15 * abs(energy.value(q)) / STEP
        _compare(f"{name}.gradient", "value", (gradient * local).sum(),
                 (energy.value(ahead) - energy.value(behind)) / (2 * STEP),
                 np.abs(gradient * local).sum(), rounding)
        slopes = ((energy.gradient(ahead) - energy.gradient(behind)) * local).sum(1) / (2 * STEP)
        rounding = 1e-15 * np.abs(gradient).max(initial=0.0) / STEP
        _compare(f"{name}.hessian", "gradient", np.einsum("ni,nij,nj->n", local, full, local),
                 slopes, np.einsum("ni,nij,nj->n", *map(np.abs, (local, full, local))).max(
                     initial=0.0), rounding)
    present = (dofs[:, :, None] >= 0) & (dofs[:, None, :] >= 0)
    values = np.linalg.eigvalsh(np.where(present, convex, 0.0))
    if values.min(initial=0.0) < -1e-9 * np.abs(values).max(initial=0.0):
        raise InputError(f"{name}.hessian(q, convex=True) has the negative eigenvalue "
                         f"{values.min():.3g}; it must be positive semi-definite")


def _compare(
    name: str, of: str, derivative: np.ndarray, difference: np.ndarray, size: float,
    rounding: float
) -> None:
    derivative, difference = np.atleast_1d(derivative), np.atleast_1d(difference)
    error = np.abs(derivative - difference)
    worst = int(error.argmax()) if len(error) else 0
    if len(error) and not error[worst] <= TOLERANCE * size + 100 * rounding:
        raise InputError(f"{name} is not the derivative of the {of}: along a random step it gives "
                         f"{derivative[worst]:.4g}, differences give {difference[worst]:.4g}"
                         + (f" (element {worst})" if len(error) > 1 else ""))
