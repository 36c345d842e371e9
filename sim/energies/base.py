"""What every energy offers: value, gradient and Hessian blocks over small stencils."""

from typing import Protocol, runtime_checkable

import numpy as np

from sim.energies.edge_frames import EdgeFrames


class Energy(Protocol):
    """A sum over elements, each a function of a few of the unknowns.

    The unknowns are one flat vector: three coordinates of every vertex (m), vertex by vertex, then
    the rotation of every edge (rad); (3V + E,) float64. ``q`` begins with the coordinates, held
    ones among them, so that energies need not know which ones are free. One of your own goes into
    a drape by :attr:`sim.laws.Laws.others` (docs/extending.md); deriving it from this class gives
    it the usual :meth:`allows`.

    Attributes:
        dofs: (N, K) int64, the unknowns each of the N elements depends on; -1 marks an absent
            one, whose gradient and Hessian entries are zero.
    """

    dofs: np.ndarray

    def value(self, q: np.ndarray) -> float:
        """Energy, J."""

    def gradient(self, q: np.ndarray) -> np.ndarray:
        """(N, K) derivatives of each element's energy by its unknowns."""

    def hessian(self, q: np.ndarray, convex: bool = False) -> np.ndarray | None:
        """(N, K, K) second derivatives of each element's energy, or None where all are zero.

        With ``convex``, a positive semi-definite approximation instead.
        """

    def allows(self, old: np.ndarray, new: np.ndarray) -> bool:
        """Whether a step from ``old`` to ``new`` stays on one branch of the energy."""
        return True


@runtime_checkable
class FramedEnergy(Energy, Protocol):
    """An energy of edges' rotations whose Hessian couples less in the frames of these edges.

    Attributes:
        frames: of the edges.
        framed_dofs: (N, M) int64, the unknowns that each element's block has there.
    """

    frames: EdgeFrames
    framed_dofs: np.ndarray

    def framed_hessian(self, q: np.ndarray, convexity: float) -> np.ndarray:
        """(N, M, M) blocks by moves in the frames at ``q``; ``convexity`` as for :meth:`hessian`.

        Their sum is the Hessian of the whole energy, where what the frames ask for is held; one
        alone is not that of its element.
        """


@runtime_checkable
class SeldomEnergy(Energy, Protocol):
    """An energy whose Hessian is nearly always zero, and which has no place in patterns then."""

    def is_felt(self, q: np.ndarray) -> bool:
        """Whether :meth:`hessian` is not None at ``q``."""


def blend_eigenvalue(value: float, convexity: float) -> float:
    """A negative eigenvalue shrunk by ``convexity``; see :meth:`Energy.hessian`."""
    return value if value > 0.0 else (1.0 - convexity) * value
