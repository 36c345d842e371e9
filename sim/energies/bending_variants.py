"""Variants of the plate: natural curvature, coupling of bending with twist, and hysteresis.

*Natural curvature*: the two faces of a cloth differ, as after weaving, finishing or storage. With
the plate's form A (:func:`sim.energies.bending_law.form`) and the natural curvature
S0 in warp/weft axes, which may vary over the cloth (:mod:`sim.energies.uneven`), a torque is added
to that of mid-edge bending:

    psi(S) - S : A : S0.

For a linear fabric this equals psi(S - S0) up to a constant, and S0 is the curvature at rest. For a
softening fabric the moment is the same, the curvature at rest slightly different. Free edges curl.

*Hysteresis* (docs/physics.md): a share of the torque does not come back. The moduli are those of
the loading curve; cloth that is bent back has less torque, by 2HB. The stress becomes

    dpsi/dS(S) - F(S) + F(S - S1),

with F the stress of a friction that is saturated, at HB, beyond a change of curvature Y/HB:

    F(C) = f(|C|/Y) P C/|C|,   |C|² = C : P : C,   f(y) = (5 y - y⁵)/4 for y < 1, else 1.

P is the plate form of HB², so that a cylinder along warp, bias or weft has the friction of that
direction. S1, the origin, is the curvature at which the friction is zero. It is zero in cloth that
has not been bent, which therefore follows the loading curve. It follows the cloth
(:meth:`HystereticBending.origin_at`): where |S - S1| exceeds Y, S1 is moved towards S until it does
not (the radial return of plasticity). Beyond the build-up, bending back from any curvature gives
2HB. HB is a share of the torque of the loading curve at 1 cm⁻¹.
"""

import copy
from dataclasses import dataclass

import numpy as np

from common.errors import InputError
from common.types import Curvatures, FaceMask, StateVector
from sim.energies import bending_law
from sim.energies.bending_law import PLAIN, Variant
from sim.energies.midedge import MidEdgeBending
from sim.energies.uneven import Uneven
from sim.material import BIAS, KES_CURVATURE, WARP, WEFT, Fabric, plate_constants, torque
from sim.mesh import Mesh

BUILD_UP = 0.03
"""Smallest change of curvature, relative to :data:`KES_CURVATURE`, that saturates the friction."""
_MAX_SHARE_OF_STIFFNESS = 0.95  # of the friction in the stiffness of flat cloth


@dataclass(frozen=True, eq=False)
class Hysteresis:
    """A bending law (:class:`sim.cloth.Law`) with hysteresis, natural curvature and coupling.

    Attributes:
        share: HB over the torque of the loading curve at the curvature ``at``, one number or
            (warp, bias, weft).
        added: whether the moduli are those of the elastic part alone, as KES's B, so that the
            friction adds to them: HB is the same share of their sum.
        curvature: natural curvature (Sxx, Syy, Sxy), 1/m, along warp, along weft and of twist;
            positive bends the cloth down when its faces are counter-clockwise seen from above.
        uneven: further natural curvature, and layers of cloth, that vary over the specimen.
        skew: coupling, see :func:`sim.energies.bending_law.constants`.
        origin: (N, 3) S1 of the active triangles of a mesh, 1/m; None: zero.
        at: curvature, 1/m, at which HB is read.
    """

    share: float | tuple[float, float, float] = 0.0
    added: bool = False
    curvature: tuple[float, float, float] = (0.0, 0.0, 0.0)
    uneven: Uneven | None = None
    skew: float = 0.0
    origin: np.ndarray | None = None
    at: float = KES_CURVATURE

    def __post_init__(self) -> None:
        share = np.asarray(self.share, float)
        if share.shape not in ((), (3,)) or not ((share >= 0) & (share < 0.5)).all():
            raise InputError(f"a hysteresis share of {self.share}: give a number from 0 to 0.5, or "
                             "three, for warp, bias and weft")
        if np.shape(self.curvature) != (3,) or not np.isfinite(self.curvature).all():
            raise InputError(f"curvature={self.curvature}: give three finite numbers, 1/m: along "
                             "warp, along weft and of twist")
        if not abs(self.skew) < 1:
            raise InputError(f"skew={self.skew:g}: no elastic plate has it; give -1 to 1")

    def __call__(self, mesh: Mesh, active: FaceMask, *, fabric: Fabric) -> "HystereticBending":
        return HystereticBending(mesh, active, fabric=fabric, law=self)

    def friction(self, fabric: Fabric) -> np.ndarray:
        """HB (3,), N, of ``fabric`` along warp, bias and weft."""
        share = np.broadcast_to(self.share, 3)
        scale = share / (1 - share) if self.added else share
        return scale * torque(self.at, fabric.alpha, fabric.beta)

    def variant(self, fabric: Fabric) -> Variant:
        """Constants of the hysteresis of ``fabric``."""
        friction = self.friction(fabric)
        if not friction.any():
            return PLAIN
        # A plate form exists only above this friction along the bias (sim.material.bias_limit).
        least = 0.51 * abs(friction[WARP] - friction[WEFT])
        friction[BIAS] = max(friction[BIAS], least)
        a11, a22, a12, a66 = plate_constants(friction**2)
        limit = BUILD_UP * self.at * float(friction.mean())
        if not self.added:
            # The elastic part of flat cloth keeps a positive stiffness.
            stiffness = float((friction**2 / fabric.alpha).max())
            limit = max(limit, 1.25 * stiffness / _MAX_SHARE_OF_STIFFNESS)
        return Variant(
            p_xx=a11, p_yy=a22, p_mixed=a12, p_xy=4 * a66, limit=limit, slid=1.0,
            returned=0.0 if self.added else 1.0)


class HystereticBending(MidEdgeBending):
    """Plate energy of the free triangles with the ``law`` :class:`Hysteresis`."""

    def __init__(self, mesh: Mesh, active: FaceMask, *, fabric: Fabric, law: Hysteresis) -> None:
        self._hysteresis = law
        self.natural = np.array([law.curvature])
        if law.uneven:
            self.natural = self.natural + law.uneven.curvature_at(mesh, active)
        super().__init__(mesh, active, fabric=fabric)
        if law.uneven and law.uneven.hem_layers:
            self.layers = law.uneven.layers_at(mesh, active)
            self.areas = self.areas * self.layers
        if law.origin is not None and law.origin.shape != self.origin.shape:
            raise InputError(f"origin has shape {law.origin.shape}, this mesh needs "
                             f"{self.origin.shape}; find its equilibrium with "
                             "sim.equilibrium.find_equilibrium")
        self.origin = self.origin if law.origin is None else law.origin

    def _set_fabric(self, fabric: Fabric) -> None:
        super()._set_fabric(fabric)
        self.law = bending_law.constants(fabric, self._hysteresis.skew)
        self.variant = self._hysteresis.variant(fabric)
        self.moments = self.natural @ self.form  # (N or 1, 3) N, of natural curvature

    def response(
        self, curvatures: Curvatures, tangents: bool = True
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        density, stress, tangent = super().response(curvatures, tangents)
        return (density - np.einsum("ni,ni->n", curvatures, np.broadcast_to(
            self.moments, curvatures.shape)), stress - self.moments, tangent)

    def with_origin(self, origin: Curvatures) -> "HystereticBending":
        """The energy with another ``origin`` S1 (N, 3), 1/m, which shares all else."""
        other = copy.copy(self)
        other.origin = origin
        return other

    def origin_at(self, q: StateVector) -> Curvatures:
        """S1 after the cloth has reached the state ``q``."""
        variant = self.variant
        if not variant.slid:
            return self.origin
        curvatures = self.curvatures(q)
        change = curvatures - self.origin
        x, y, z = change.T
        size = np.sqrt(variant.p_xx * x * x + 2 * variant.p_mixed * x * y + variant.p_yy * y * y
                       + variant.p_xy * z * z)
        kept = np.minimum(variant.limit / np.maximum(size, 1e-300), 1.0)
        return curvatures - kept[:, None] * change
