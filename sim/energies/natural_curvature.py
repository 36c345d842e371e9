"""Cloth with a natural curvature: its two faces differ, as after weaving, finishing or storage.

A constant torque is added to that of mid-edge bending (:mod:`sim.energies.midedge`): with the
plate constants A of the fabric (:func:`sim.material.plate_constants`) and the natural curvature
S0 in warp/weft axes,

    psi(S) - S : A : S0.

For a linear fabric this equals psi(S - S0) up to a constant, and S0 is the curvature at rest. For a
softening fabric the moment is the same, the curvature at rest slightly different. Free edges curl.
"""

from dataclasses import dataclass

import numpy as np

from common.errors import InputError
from sim.energies.midedge import MidEdgeBending
from sim.material import Fabric, plate_constants
from sim.mesh import Mesh


@dataclass(frozen=True)
class NaturallyCurved:
    """A bending law (:class:`sim.laws.Law`) with a natural curvature.

    Attributes:
        curvature: (Sxx, Syy, Sxy), 1/m, along warp, along weft and of twist; positive bends the
            cloth as in a drape, down when its faces are counter-clockwise seen from above.

    Raises:
        InputError: not three finite numbers.
    """

    curvature: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        if np.shape(self.curvature) != (3,) or not np.isfinite(self.curvature).all():
            raise InputError(f"curvature={self.curvature}: give three finite numbers, 1/m: along "
                             "warp, along weft and of twist")

    def __call__(self, mesh: Mesh, active: np.ndarray, *, fabric: Fabric) -> "CurvedBending":
        return CurvedBending(mesh, active, fabric=fabric, curvature=np.array(self.curvature))


class CurvedBending(MidEdgeBending):
    """Plate energy of the free triangles with a natural ``curvature`` (3,), 1/m; other arguments
    are those of :class:`sim.energies.midedge.MidEdgeBending`."""

    def __init__(
        self, mesh: Mesh, active: np.ndarray, *, fabric: Fabric, curvature: np.ndarray
    ) -> None:
        self._curvature = curvature
        super().__init__(mesh, active, fabric=fabric)

    def _set_fabric(self, fabric: Fabric) -> None:
        super()._set_fabric(fabric)
        a11, a22, a12, a66 = plate_constants(fabric.alpha)
        xx, yy, xy = self._curvature
        self._moment = np.array([a11 * xx + a12 * yy, a12 * xx + a22 * yy, 4 * a66 * xy])

    def density(self, curvatures: np.ndarray) -> np.ndarray:
        return super().density(curvatures) - curvatures @ self._moment

    def stress(self, curvatures: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        stress, tangent = super().stress(curvatures)
        return stress - self._moment, tangent
