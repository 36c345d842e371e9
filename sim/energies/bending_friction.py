"""Bending with internal friction: hysteresis and several equilibria.

A fabric's torque at a curvature differs between bending and unbending by 2HB, its hysteresis in
Kawabata's pure bending test. Here a torque of at most HB resists every change of the curvature S
from an origin S0 at which there is no friction. The energy of mid-edge bending
(:mod:`sim.energies.midedge`) gains the term

    m (sqrt(|S - S0|² + d²) - d),    |S|² = Sxx² + Syy² + 2 Sxy²,

with m = HB and a small change of curvature d within which the friction builds up. This is one step
of Coulomb friction, from S0 to the equilibrium; S0 is constant, so there are no load cycles.
"""

from dataclasses import dataclass

import numpy as np

from common.errors import InputError
from sim.energies.natural_curvature import CurvedBending, NaturallyCurved
from sim.energies.plate_law import METRIC
from sim.material import Fabric
from sim.mesh import Mesh

BUILD_UP = 2.0
"""Change of curvature, 1/m, within which friction builds up."""


@dataclass(frozen=True, eq=False)
class BendingFriction:
    """A bending law (:class:`sim.laws.Law`) with friction.

    Attributes:
        torque: m, N·m per metre of width, of cloth of 300 g/m², at which drapes are simulated.
        origin: (N, 3) curvatures S0, 1/m, of the active triangles, as
            returned by :meth:`sim.energies.midedge.MidEdgeBending.curvatures`; valid for one mesh
            only, so that a drape, which uses several, cannot have them. None: flat.
        build_up: d, 1/m.
        curvature: natural curvature, see :class:`sim.energies.natural_curvature.NaturallyCurved`.

    Raises:
        InputError: negative torque, build-up not above 0, or a curvature that is not valid for
            :class:`sim.energies.natural_curvature.NaturallyCurved`.
    """

    torque: float
    origin: np.ndarray | None = None
    build_up: float = BUILD_UP
    curvature: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        if not (self.torque >= 0 and self.build_up > 0):
            raise InputError(f"friction of {self.torque} N within {self.build_up} 1/m: give a "
                             "torque of 0 or more and a change of curvature above 0")
        NaturallyCurved(self.curvature)  # raises for an invalid curvature

    def __call__(self, mesh: Mesh, active: np.ndarray, *, fabric: Fabric) -> "FrictionBending":
        return FrictionBending(mesh, active, fabric=fabric, friction=self)


class FrictionBending(CurvedBending):
    """Plate energy of the free triangles with ``friction``; other arguments are those of
    :class:`sim.energies.midedge.MidEdgeBending`."""

    def __init__(
        self, mesh: Mesh, active: np.ndarray, *, fabric: Fabric, friction: BendingFriction
    ) -> None:
        super().__init__(mesh, active, fabric=fabric, curvature=np.array(friction.curvature))
        self._torque, self._build_up = friction.torque, friction.build_up
        self._origin = 0.0 if friction.origin is None else friction.origin
        if np.shape(self._origin) not in ((), (shape := (int(active.sum()), 3))):
            raise InputError(f"origin has shape {np.shape(self._origin)}, this mesh needs {shape}; "
                             "find its equilibrium with sim.equilibrium.find_equilibrium")

    def density(self, curvatures: np.ndarray) -> np.ndarray:
        friction = self._torque * (self._size(curvatures - self._origin) - self._build_up)
        return super().density(curvatures) + friction

    def stress(self, curvatures: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        stress, tangent = super().stress(curvatures)
        change = curvatures - self._origin
        size = self._size(change)[:, None]
        direction = METRIC * change / size
        dyad = direction[:, :, None] * direction[:, None, :]
        stiffness = (np.diag(METRIC) - dyad) / size[..., None]
        return stress + self._torque * direction, tangent + self._torque * stiffness

    def _size(self, change: np.ndarray) -> np.ndarray:
        return np.sqrt(change**2 @ METRIC + self._build_up**2)
