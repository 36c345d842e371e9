"""What every energy offers: value, gradient and Hessian blocks over small stencils."""

from typing import Protocol

import numpy as np

from common.errors import InputError


class Energy(Protocol):
    """A sum over elements, each a function of a few of the unknowns.

    Unknowns are the coordinates of the vertices (m), three by three, then the rotation of the
    normal of every edge (rad): 3 V + E. A state ``q`` holds the coordinates, then the normals
    themselves, (3 V + 3 E,) float64 (:mod:`sim.state`); derivatives are those of a step from
    there. Held coordinates are part of it, so that energies need not know which ones are free. An
    energy of your own goes into a drape by :attr:`sim.laws.Laws.others` (docs/extending.md);
    deriving it from this class gives it the usual :meth:`allows`.

    Attributes:
        dofs: (N, K) int64, the unknowns each of the N elements depends on; -1 marks an absent
            one, whose gradient and Hessian entries have no effect.
    """

    dofs: np.ndarray

    def value(self, q: np.ndarray) -> float:
        """Energy, J."""

    def gradient(self, q: np.ndarray) -> np.ndarray:
        """(N, K) derivatives of each element's energy by its unknowns."""

    def hessian(self, q: np.ndarray, convex: bool = False) -> np.ndarray | None:
        """(N, K, K) second derivatives of each element's energy, or None where all are zero. With
        ``convex``, a positive semi-definite approximation instead."""

    def allows(self, old: np.ndarray, new: np.ndarray) -> bool:
        """Whether a step from ``old`` to ``new`` stays on one branch of the energy."""
        return True


def dofs_of(energy: Energy) -> np.ndarray:
    """(N, K), the ``dofs`` of an energy; InputError where there are none of that form."""
    dofs = np.asarray(getattr(energy, "dofs", None))
    if dofs.ndim != 2 or not np.issubdtype(dofs.dtype, np.integer):
        raise InputError(f"{type(energy).__name__}.dofs must be an array (N, K) of integers: the "
                         "unknowns that each element depends on (sim.energies.base.Energy)")
    return dofs
