"""Cloth that is bent by nature: its faces differ, as after weaving, finishing or storage.

A constant torque is added to that of mid-edge bending (:mod:`sim.energies.midedge`): with the
plate constants A of the fabric (:func:`sim.material.plate_constants`) and the natural curvature
S0 in warp/weft axes,

    psi(S) - S : A : S0.

For a linear fabric this is psi(S - S0) but for a constant: it rests with the curvature S0. For one
that softens it is the same moment, not exactly the same curvature. A free edge curls.
"""

from dataclasses import dataclass

import numba
import numpy as np

from sim.energies import dihedral
from sim.energies.midedge import MidEdgeBending, _angle_rows, _first_rows, _load_hinge
from sim.material import Fabric, plate_constants
from sim.mesh import Mesh


@dataclass(frozen=True)
class NaturallyCurved:
    """A bending law (:class:`sim.laws.Bending`) with a natural curvature.

    Attributes:
        curvature: (Sxx, Syy, Sxy), 1/m, along warp, weft and of twist; positive bends the cloth
            down on the side from which its faces run counter-clockwise, as a drape hangs.
    """

    curvature: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def __call__(self, mesh: Mesh, active: np.ndarray, *, fabric: Fabric) -> "CurvedBending":
        return CurvedBending(mesh, active, fabric=fabric, curvature=np.array(self.curvature))


class CurvedBending(MidEdgeBending):
    """Plate energy of the free triangles with a natural ``curvature`` (3,), 1/m.

    The other arguments are those of :class:`sim.energies.midedge.MidEdgeBending`.
    """

    def __init__(
        self, mesh: Mesh, active: np.ndarray, *, fabric: Fabric, curvature: np.ndarray
    ) -> None:
        super().__init__(mesh, active, fabric=fabric)
        a11, a22, a12, a66 = plate_constants(fabric.alpha)
        xx, yy, xy = curvature
        moment = np.array([a11 * xx + a12 * yy, a12 * xx + a22 * yy, 4 * a66 * xy])
        # The torque on each edge's angle phi, (N, 3): constant.
        self._torque = -self.areas[:, None] * np.einsum("a,tai->ti", moment, self.maps)
        self._moment = moment

    def value(self, q: np.ndarray) -> float:
        return super().value(q) - float(self.areas @ (self.curvatures(q) @ self._moment))

    def gradient(self, q: np.ndarray) -> np.ndarray:
        return super().gradient(q) + _gradient(q, self.dofs, self.share, self.sign, self._torque)

    def hessian(self, q: np.ndarray, convexity: float) -> np.ndarray:
        blocks = super().hessian(q, convexity)
        if convexity < 1.0:
            _add_hessian(q, self.dofs, self.share, (1.0 - convexity) * self._torque, blocks)
        return blocks


@numba.njit(cache=True)
def _gradient(q, dofs, share, sign, torque):
    result = np.zeros((len(dofs), 21))
    x, g, rows = np.empty((4, 3)), np.empty((4, 3)), np.empty((3, 21))
    for t in range(len(dofs)):
        _angle_rows(q, dofs[t], share[t], sign[t], x, g, rows)
        for i in range(3):
            for k in range(21):
                result[t, k] += torque[t, i] * rows[i, k]
    return result


@numba.njit(cache=True)
def _add_hessian(q, dofs, share, torque, blocks):
    x, frame = np.empty((4, 3)), np.empty((3, 3))
    for t in range(len(dofs)):
        for i in range(3):
            if share[t, i] != 0.0:
                _load_hinge(q, dofs[t], i, x)
                dihedral.add_hessian(
                    x, torque[t, i] * share[t, i], _first_rows(i), frame, blocks[t]
                )
