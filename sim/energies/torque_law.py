"""Isotropic bending with a tabulated torque curve.

With |S|² = Sxx² + Syy² + 2 Sxy² and W the integral of the torque over curvature, the energy per
area is W(|S|): cloth bent to a cylinder along any direction carries the torque of the curve. For
the curve of :func:`sim.material.torque` this is the law of an isotropic fabric
(:mod:`sim.energies.plate_law`).
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.interpolate import PchipInterpolator

from common.errors import InputError
from sim.energies.midedge import MidEdgeBending
from sim.energies.plate_law import METRIC
from sim.material import Fabric
from sim.mesh import Mesh

_MIN_CURVATURE = 1e-6  # 1/m, below which cloth counts as flat


@dataclass(frozen=True, eq=False)
class TorqueLaw:
    """A bending law (:class:`sim.laws.Law`), estimated by :mod:`sim.cantilever.torque_curve`.

    The torque is the monotone cubic spline (PCHIP) through the knots, continued linearly with the
    slope of the last interval. The moduli of the fabric are ignored.

    Attributes:
        curvature, torque: (K,) 1/m and N per width, of cloth of 300 g/m², at which drapes are
            simulated; both increasing from 0.

    Raises:
        InputError: a curve that does not increase from 0.
    """

    curvature: np.ndarray
    torque: np.ndarray

    def __post_init__(self) -> None:
        if len(self.curvature) != len(self.torque):
            raise InputError(f"a torque curve of {len(self.curvature)} curvatures and "
                             f"{len(self.torque)} torques: give as many of each")
        knots = np.array([self.curvature, self.torque], dtype=np.float64)
        if not (knots.shape[1] > 2 and np.isfinite(knots).all() and not knots[:, 0].any()
                and (np.diff(knots) > 0).all()):
            raise InputError("a torque curve needs three or more curvatures and torques, both "
                             "increasing from 0")

    @cached_property
    def spline(self) -> PchipInterpolator:
        """Torque, N, by curvature, 1/m."""
        # A repetition of the last interval: PCHIP is linear there.
        return PchipInterpolator(*(np.append(v, 2 * v[-1] - v[-2])
                                   for v in (self.curvature, self.torque)))

    def __call__(self, mesh: Mesh, active: np.ndarray, *, fabric: Fabric) -> "CurveBending":
        return CurveBending(mesh, active, law=self)


class CurveBending(MidEdgeBending):
    """Energy of the free triangles by a :class:`TorqueLaw`."""

    def __init__(self, mesh: Mesh, active: np.ndarray, *, law: TorqueLaw) -> None:
        self._torque, self._work = law.spline, law.spline.antiderivative()
        self._stiffness = law.spline.derivative()
        # For the fold barrier and the minimum stiffness of the convex Hessian.
        super().__init__(mesh, active, fabric=Fabric(np.full(3, float(self._stiffness(0.0)))))

    def density(self, curvatures: np.ndarray) -> np.ndarray:
        return self._work(np.sqrt(curvatures**2 @ METRIC))

    def stress(self, curvatures: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        size = np.maximum(np.sqrt(curvatures**2 @ METRIC), _MIN_CURVATURE)
        direction = METRIC * curvatures / size[:, None]
        torque, across = self._torque(size), (self._torque(size) / size)[:, None, None]
        along = self._stiffness(size)[:, None, None] - across
        tangent = across * np.diag(METRIC) + along * direction[:, :, None] * direction[:, None, :]
        return torque[:, None] * direction, tangent
