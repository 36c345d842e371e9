"""In-plane materials: their parameters, checks and laws. SI units.

Stiffnesses are those of cloth of 300 g/m², at which drapes are simulated.
"""

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Protocol

import numpy as np
from scipy.interpolate import PchipInterpolator

from common.errors import InputError
from sim.energies.base import Energy
from sim.energies.locking import Band, ComponentGuard, PrincipalGuard
from sim.energies.membrane import CorotationalMembrane
from sim.energies.strain import StrainLaw, StrainMembrane
from sim.mesh import Mesh


class Membrane(Protocol):
    """An in-plane material."""

    def energy(self, mesh: Mesh, active: np.ndarray) -> Energy:
        """The energy of the triangles ``active`` (F,) bool of ``mesh``."""

    def scaled(self, factor: float) -> "Membrane":
        """The same material, ``factor`` times as stiff."""


class Guardable(Membrane, Protocol):
    """A membrane that :class:`Guarded` can wrap."""

    def guarded_law(self, low: float, high: float, share: float) -> StrainLaw:
        """The law with stretches between ``low`` and ``high`` free but for ``share`` of it."""


@dataclass(frozen=True)
class Corotational:
    """Isotropic corotational membrane (section 4.1), the default.

    Attributes:
        stiffness: Young's modulus times thickness, N/m.
        poisson: Poisson's ratio in the plane.

    Raises:
        InputError: no stable material has these.
    """

    stiffness: float = 200.0
    poisson: float = 0.3

    def __post_init__(self) -> None:
        _check_positive(stiffness=self.stiffness)
        if not -1 < self.poisson < 1:
            raise InputError(f"poisson={self.poisson:g} must lie between -1 and 1")

    def energy(self, mesh: Mesh, active: np.ndarray) -> Energy:
        return CorotationalMembrane(mesh, active, stiffness=self.stiffness, poisson=self.poisson)

    def scaled(self, factor: float) -> "Corotational":
        return replace(self, stiffness=factor * self.stiffness)

    def guarded_law(self, low: float, high: float, share: float) -> StrainLaw:
        band = Band(low - 1, high - 1, share)
        return PrincipalGuard(stiffness=self.stiffness, poisson=self.poisson, band=band)


class _StrainMaterial:
    """What materials given by a law of the Green strain have in common; they are their own law."""

    def energy(self, mesh: Mesh, active: np.ndarray) -> Energy:
        return StrainMembrane(mesh, active, self)

    def guarded_law(self, low: float, high: float, share: float) -> StrainLaw:
        # Green strains of the stretches, and the shear that both together make at 45°.
        below, above = (low**2 - 1) / 2, (high**2 - 1) / 2
        shear = above - below
        limits = np.array([[below, below, -shear], [above, above, shear]])
        return ComponentGuard(self, Band(*limits, share))


@dataclass(frozen=True)
class OrthotropicStVK(_StrainMaterial):
    """Orthotropic St. Venant-Kirchhoff membrane (Larionov et al., Eq. 5 and 6).

    S_uu = (E_warp e_uu + n E_weft e_vv)/d, S_vv = (n E_weft e_uu + E_weft e_vv)/d,
    S_uv = shear 2 e_uv, with d = 1 - n² E_weft/E_warp and n Poisson's ratio.

    Attributes:
        warp, weft: Young's moduli times thickness, N/m.
        poisson: contraction along weft over extension along warp when pulled along warp; the
            other way round it is ``poisson * weft / warp``.
        shear: shear modulus times thickness, N/m.

    Raises:
        InputError: no stable material has these.
    """

    warp: float = 200.0
    weft: float = 200.0
    poisson: float = 0.3
    shear: float = 200.0 / 2.6

    def __post_init__(self) -> None:
        _check_positive(warp=self.warp, weft=self.weft, shear=self.shear)
        if not self.poisson**2 * self.weft < self.warp:
            limit = (self.warp / self.weft) ** 0.5
            raise InputError(
                f"poisson={self.poisson:g} must stay below {limit:.3g} for these warp and weft "
                "moduli"
            )

    def scaled(self, factor: float) -> "OrthotropicStVK":
        return replace(self, **{k: factor * getattr(self, k) for k in ("warp", "weft", "shear")})

    @cached_property
    def _stiffness(self) -> np.ndarray:
        d = 1 - self.poisson**2 * self.weft / self.warp
        coupling = self.poisson * self.weft / d
        return np.array([[self.warp / d, coupling, 0.0], [coupling, self.weft / d, 0.0],
                         [0.0, 0.0, self.shear]])

    def density(self, strain: np.ndarray) -> np.ndarray:
        return 0.5 * np.einsum("ni,ni->n", strain, self.stress(strain))

    def stress(self, strain: np.ndarray) -> np.ndarray:
        return strain @ self._stiffness

    def tangent(self, strain: np.ndarray) -> np.ndarray:
        return np.broadcast_to(self._stiffness, (len(strain), 3, 3))


Knots = tuple[tuple[float, float], ...]


@dataclass(frozen=True)
class NonlinearCurves(_StrainMaterial):
    """Diagonalised membrane: a stress curve for each component (Miguel et al., section 4).

    A curve is a monotone cubic through its knots (PCHIP, whose slope never vanishes between
    increasing knots), so that the energy has two continuous derivatives, and straight from the last
    knot on. That of shear is odd; pushed together along a yarn, cloth is as stiff as at rest.

    Attributes:
        warp, weft: knots (Green strain, stress in N/m) of pulling along each direction, both
            increasing from (0, 0).
        shear: knots (2 E_uv, stress in N/m), the same.

    Raises:
        InputError: a curve that does not increase from (0, 0).
    """

    warp: Knots = ((0.0, 0.0), (0.02, 2.0), (0.06, 14.0))
    weft: Knots = ((0.0, 0.0), (0.02, 2.0), (0.06, 14.0))
    shear: Knots = ((0.0, 0.0), (0.1, 2.0), (0.3, 20.0))

    def __post_init__(self) -> None:
        for name in ("warp", "weft", "shear"):
            knots = np.asarray(getattr(self, name), dtype=np.float64)
            good = knots.ndim == 2 and len(knots) > 1 and knots.shape[1] == 2
            if not (good and (np.diff(knots, axis=0) > 0).all() and np.isfinite(knots).all()):
                raise InputError(
                    f"{name}: a stress curve needs two or more pairs of strain and stress, both "
                    "increasing"
                )
            if knots[0].any():
                raise InputError(f"{name}: a stress curve starts at strain 0 and stress 0")

    def scaled(self, factor: float) -> "NonlinearCurves":
        def scale(knots: Knots) -> Knots:
            return tuple((strain, factor * stress) for strain, stress in knots)

        return NonlinearCurves(*(scale(k) for k in (self.warp, self.weft, self.shear)))

    @cached_property
    def _curves(self) -> tuple["_StressCurve", ...]:
        return tuple(_StressCurve(knots, odd=odd) for knots, odd in
                     ((self.warp, False), (self.weft, False), (self.shear, True)))

    def density(self, strain: np.ndarray) -> np.ndarray:
        return sum(curve(x)[0] for curve, x in zip(self._curves, strain.T, strict=True))

    def stress(self, strain: np.ndarray) -> np.ndarray:
        return np.column_stack(
            [curve(x)[1] for curve, x in zip(self._curves, strain.T, strict=True)])

    def tangent(self, strain: np.ndarray) -> np.ndarray:
        result = np.zeros((len(strain), 3, 3))
        for i, curve in enumerate(self._curves):
            result[:, i, i] = curve(strain[:, i])[2]
        return result


class _StressCurve:
    """Energy, stress and slope of one strain component."""

    def __init__(self, knots: Knots, *, odd: bool) -> None:
        strain, stress = np.asarray(knots, dtype=np.float64).T
        # The mirrored knots and one more beyond the end give both ends their secants' slopes.
        x = np.concatenate([-strain[::-1], strain[1:], [2 * strain[-1] - strain[-2]]])
        y = np.concatenate([-stress[::-1], stress[1:], [2 * stress[-1] - stress[-2]]])
        self._stress = PchipInterpolator(x, y)
        self._slope, self._energy = self._stress.derivative(), self._stress.antiderivative()
        self._least, self._most = (-strain[-1] if odd else 0.0), strain[-1]

    def __call__(self, strain: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        within = np.clip(strain, self._least, self._most)
        beyond, stress, slope = strain - within, self._stress(within), self._slope(within)
        energy = self._energy(within) - self._energy(0.0) + beyond * (stress + 0.5 * beyond * slope)
        return energy, stress + beyond * slope, slope


@dataclass(frozen=True)
class Guarded:
    """Another membrane with free strain around rest, against locking.

    See :mod:`sim.energies.locking`. The corotational law is free in its principal stretches,
    the others in warp, weft and shear.

    Attributes:
        membrane: what resists outside the band.
        low, high: stretches between which the cloth is free; the paper's 99 % and 101 %.
        share: of the membrane's stiffness that remains within the band.

    Raises:
        InputError: a band that does not contain 1, a share that is not in (0, 1), or a membrane
            that cannot be wrapped.
    """

    membrane: Guardable = field(default_factory=lambda: Corotational(stiffness=5000.0))
    low: float = 0.99
    high: float = 1.01
    share: float = 0.02

    def __post_init__(self) -> None:
        if not 0 < self.low < 1 < self.high < np.inf:
            raise InputError(f"free stretch from {self.low:g} to {self.high:g} must contain 1")
        if not 0 < self.share < 1:
            raise InputError(f"share={self.share:g} must lie between 0 and 1")
        if not hasattr(self.membrane, "guarded_law"):
            raise InputError(f"membrane={self.membrane!r} cannot be guarded; give one that has a "
                             "guarded_law, such as Corotational()")

    def energy(self, mesh: Mesh, active: np.ndarray) -> Energy:
        law = self.membrane.guarded_law(self.low, self.high, self.share)
        return StrainMembrane(mesh, active, law)

    def scaled(self, factor: float) -> "Guarded":
        return replace(self, membrane=self.membrane.scaled(factor))


def _check_positive(**values: float) -> None:
    for name, value in values.items():
        if not (np.isfinite(value) and value > 0):
            raise InputError(f"{name}={value:g} must be a positive number of N/m")
