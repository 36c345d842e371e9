"""What every energy offers: value, gradient and Hessian blocks over small stencils."""

from typing import Protocol

import numpy as np


class Energy(Protocol):
    """A sum over elements, each a function of a few of the unknowns.

    The unknowns are one flat vector ``q``: three coordinates of every vertex (m), vertex by
    vertex, then the rotation of every edge (rad); (3V + E,) float64. Held coordinates are part
    of it, so energies need not know which ones are free. One of your own goes into a drape by
    :attr:`sim.laws.Laws.others` (docs/extending.md).

    Attributes:
        dofs: (N, K) int64, the entries of ``q`` each of the N elements depends on; -1 marks an
            absent one, whose gradient and Hessian entries are zero.
    """

    dofs: np.ndarray

    def value(self, q: np.ndarray) -> float:
        """Energy, J."""

    def gradient(self, q: np.ndarray) -> np.ndarray:
        """(N, K) derivatives of each element's energy by its unknowns."""

    def hessian(self, q: np.ndarray, convexity: float) -> np.ndarray | None:
        """(N, K, K) second derivatives of each element's energy, or None where all are zero.

        ``convexity`` in [0, 1] removes that share of the indefinite part: 0 gives the exact
        Hessian, 1 a positive semi-definite one; the result is linear in between.
        """

    def allows(self, old: np.ndarray, new: np.ndarray) -> bool:
        """Whether a step from ``old`` to ``new`` stays on one branch of the energy."""


def blend_eigenvalue(value: float, convexity: float) -> float:
    """A negative eigenvalue shrunk by ``convexity``; see :meth:`Energy.hessian`."""
    return value if value > 0.0 else (1.0 - convexity) * value
