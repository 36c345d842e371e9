"""Interface of an energy: value, gradient and Hessian blocks over small stencils."""

from typing import Protocol

import numpy as np

from common.errors import InputError


class Energy(Protocol):
    """A sum over elements, each a function of a few of the unknowns.

    Unknowns are the coordinates of the vertices (m), three per vertex, then the rotation of every
    edge normal (rad): 3 V + E. A state ``q`` holds the coordinates, then the normals, (3 V + 3 E,)
    float64 (:mod:`sim.solver.state`); derivatives are with respect to a step from it. It includes
    held coordinates, so that energies need not know which ones are free. User-defined energies
    enter a drape by :attr:`sim.laws.Laws.others` (docs/extending.md); deriving them from this class
    provides the default :meth:`allows`.

    Attributes:
        dofs: (N, K) int64, unknowns of each of the N elements; -1 marks an absent one, whose
            gradient and Hessian entries are ignored.
    """

    dofs: np.ndarray

    def value(self, q: np.ndarray) -> float:
        """Energy, J, at the state ``q``."""

    def gradient(self, q: np.ndarray) -> np.ndarray:
        """Derivatives (N, K) of each element's energy by its unknowns."""

    def hessian(self, q: np.ndarray, convex: bool = False) -> np.ndarray | None:
        """Second derivatives (N, K, K) of each element's energy, or None if all are zero; with
        ``convex``, a positive semi-definite approximation."""

    def allows(self, old: np.ndarray, new: np.ndarray) -> bool:
        """Whether a step from ``old`` to ``new`` stays on one branch of the energy."""
        return True


def dofs_of(energy: Energy) -> np.ndarray:
    """The ``dofs`` (N, K) of an energy; InputError if they are missing or have another form."""
    dofs = np.asarray(getattr(energy, "dofs", None))
    if dofs.ndim != 2 or not np.issubdtype(dofs.dtype, np.integer):
        raise InputError(f"{type(energy).__name__}.dofs must be an array (N, K) of integers: the "
                         "unknowns that each element depends on (sim.energies.base.Energy)")
    return dofs
