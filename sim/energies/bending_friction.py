"""Friction between the yarns of bent cloth, which lets it rest in more than one shape.

A fabric's torque at a curvature differs between bending and unbending by 2HB, its hysteresis in
Kawabata's pure bending test. Here a torque resists every change of the curvature S from the one
S0 at which the cloth came to rest, and holds at most HB: the energy density is

    m (sqrt(|S - S0|² + d²) - d),    |S|² = Sxx² + Syy² + 2 Sxy²,

with m = HB and a small change of curvature d within which the friction builds up. This is one step
of Coulomb friction, which moves no further than it must; S0 does not follow the cloth.
"""

import numpy as np

from sim.energies.midedge import MidEdgeBending
from sim.errors import InputError
from sim.material import Fabric
from sim.mesh import Mesh

BUILD_UP = 2.0
"""Change of curvature, 1/m, within which the friction builds up."""
_METRIC = np.array([1.0, 1.0, 2.0])  # of Sxx, Syy, Sxy


class BendingFriction(MidEdgeBending):
    """Friction of the free triangles, beside a bending energy of the same rotations of edges.

    Args:
        mesh, active, fabric: as for :class:`sim.energies.midedge.MidEdgeBending`.
        rest: (3V + E,) unknowns at which no friction acts.
        torque: m, N·m per metre.
        build_up: d, 1/m.

    Raises:
        InputError: a torque below 0, or a build-up that is not above 0.
    """

    def __init__(
        self, mesh: Mesh, active: np.ndarray, *, fabric: Fabric, rest: np.ndarray, torque: float,
        build_up: float = BUILD_UP,
    ) -> None:
        super().__init__(mesh, active, fabric=fabric)
        if not torque >= 0 or not build_up > 0:
            raise InputError(f"friction of {torque} N within {build_up} 1/m: give a torque of 0 "
                             "or more and a change of curvature above 0")
        self._torque, self._build_up = torque, build_up
        self._natural = self.curvatures(rest)

    def density(self, curvatures: np.ndarray) -> np.ndarray:
        return self._torque * (self._size(curvatures - self._natural) - self._build_up)

    def stress(self, curvatures: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        change = curvatures - self._natural
        size = self._size(change)[:, None]
        way = _METRIC * change / size
        tangent = (np.diag(_METRIC) - way[:, :, None] * way[:, None, :]) / size[..., None]
        return self._torque * way, self._torque * tangent

    @property
    def least_stiffness(self) -> float:
        """0: the bending law beside it gives the rotations of the edges their stiffness."""
        return 0.0

    def _size(self, change: np.ndarray) -> np.ndarray:
        return np.sqrt(change**2 @ _METRIC + self._build_up**2)
