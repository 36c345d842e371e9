"""Verification of the derivatives of an energy by central differences."""

import numpy as np

from common.errors import InputError
from sim.energies.base import Energy, dofs_of
from sim.solver.state import moved

STEP = 1e-7  # m, or rad
TOLERANCE = 1e-4  # relative to the magnitude of the terms
DIRECTIONS = 3


def check(energy: Energy, q: np.ndarray, edges: np.ndarray, *, seed: int = 0) -> None:
    """Compare gradient and Hessian with differences of value and gradient along random steps.

    Choose a state with non-zero energy: where it vanishes, the check is trivial.

    Args:
        q: state (3 V + 3 E,) as in :class:`sim.energies.base.Energy`.
        edges: (E, 2), of the mesh.

    Raises:
        InputError: ``dofs`` are missing or have another form, gradient or Hessian deviates from
            the differences, or the convex Hessian is not positive semi-definite.
    """
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
    name: str, of: str, given: np.ndarray, found: np.ndarray, size: float, rounding: float
) -> None:
    given, found = np.atleast_1d(given), np.atleast_1d(found)
    error = np.abs(given - found)
    worst = int(error.argmax()) if len(error) else 0
    if len(error) and not error[worst] <= TOLERANCE * size + 100 * rounding:
        raise InputError(f"{name} is not the derivative of the {of}: along a random step it gives "
                         f"{given[worst]:.4g}, differences give {found[worst]:.4g}"
                         + (f" (element {worst})" if len(error) > 1 else ""))
