"""In-plane materials: parameters in SI units and their stress-strain laws.

Stiffnesses are those of cloth of 300 g/m², at which drapes are simulated. A material is a law
(:class:`sim.energies.membrane.StrainLaw`) of its strain measure: the Green strain in warp and weft
axes, or for the corotational one the principal stretches less 1.
"""

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Protocol

import numpy as np

from common.errors import InputError
from sim.energies.base import Energy
from sim.energies.membrane import OfStretches, StrainLaw, StrainMembrane
from sim.mesh import Mesh

_ROUNDING_WIDTH = 0.5  # of the smooth transition at each limit of the band, in half bands


class Membrane(Protocol):
    """An in-plane material."""

    def energy(self, mesh: Mesh, active: np.ndarray) -> Energy:
        """The energy of the triangles ``active`` (F,) bool of ``mesh``."""

    def scaled(self, factor: float) -> "Membrane":
        """A copy of the material, ``factor`` times as stiff."""


class _Linear:
    """Stress linear in the Green strain, by a symmetric ``matrix`` (K, K), N/m."""

    matrix: np.ndarray

    def energy(self, mesh: Mesh, active: np.ndarray) -> Energy:
        return StrainMembrane(mesh, active, self.of_green_strain(self))

    def density(self, strain: np.ndarray) -> np.ndarray:
        return 0.5 * np.einsum("ni,ni->n", strain, self.stress(strain))

    def stress(self, strain: np.ndarray) -> np.ndarray:
        return strain @ self.matrix

    def tangent(self, strain: np.ndarray) -> np.ndarray:
        return np.broadcast_to(self.matrix, (len(strain), *self.matrix.shape))

    @staticmethod
    def of_green_strain(law: StrainLaw) -> StrainLaw:
        """A law of the material's strain measure as a law of the Green strain."""
        return law

    @staticmethod
    def band(low: float, high: float) -> np.ndarray:
        """Limits (2, K) of the material's strain between the stretches low and high: their Green
        strains, and the shear strain that both cause together at 45° to the yarns."""
        below, above = (low**2 - 1) / 2, (high**2 - 1) / 2
        return np.array([[below, below, below - above], [above, above, above - below]])


@dataclass(frozen=True)
class Corotational(_Linear):
    """Isotropic corotational membrane (section 4.1), the default.

    Its density mu |F - R|² + lambda/2 tr(R^T F - I)², R the isometry closest to the deformation
    gradient F, is mu (e1² + e2²) + lambda/2 (e1 + e2)² with e = s - 1, s the singular values of F.

    Attributes:
        stiffness: Young's modulus times thickness, N/m.
        poisson: in-plane Poisson's ratio, between -1 and 1.
    """

    stiffness: float = 200.0
    poisson: float = 0.3

    def __post_init__(self) -> None:
        _check_positive(stiffness=self.stiffness)
        if not -1 < self.poisson < 1:
            raise InputError(f"poisson={self.poisson:g} must lie between -1 and 1")

    @property
    def mu(self) -> float:
        """Shear modulus times thickness, N/m."""
        return self.stiffness / (2 * (1 + self.poisson))

    @property
    def lam(self) -> float:
        """Lamé's first constant in the plane times thickness, N/m."""
        return self.stiffness * self.poisson / (1 - self.poisson**2)

    @cached_property
    def matrix(self) -> np.ndarray:
        return 2 * self.mu * np.eye(2) + self.lam

    def scaled(self, factor: float) -> "Corotational":
        return replace(self, stiffness=factor * self.stiffness)

    @staticmethod
    def of_green_strain(law: StrainLaw) -> StrainLaw:
        return OfStretches(law)

    @staticmethod
    def band(low: float, high: float) -> np.ndarray:
        return np.array([[low - 1] * 2, [high - 1] * 2])


@dataclass(frozen=True)
class OrthotropicStVK(_Linear):
    """Orthotropic St. Venant-Kirchhoff membrane (Larionov et al., Eq. 5 and 6).

    S_uu = (E_warp e_uu + n E_weft e_vv)/d, S_vv = (n E_weft e_uu + E_weft e_vv)/d,
    S_uv = shear 2 e_uv, with d = 1 - n² E_weft/E_warp.

    Attributes:
        warp, weft: Young's moduli times thickness, N/m.
        poisson: n, contraction along weft over extension along warp under tension along warp;
            under tension along weft it is ``poisson * weft / warp``.
        shear: shear modulus times thickness, N/m.
    """

    warp: float = 200.0
    weft: float = 200.0
    poisson: float = 0.3
    shear: float = 200.0 / 2.6

    def __post_init__(self) -> None:
        _check_positive(warp=self.warp, weft=self.weft, shear=self.shear)
        limit = (self.warp / self.weft) ** 0.5
        if not abs(self.poisson) < limit:
            raise InputError(f"poisson={self.poisson:g} must stay below {limit:.3g} for these "
                             "warp and weft moduli")

    @cached_property
    def matrix(self) -> np.ndarray:
        d = 1 - self.poisson**2 * self.weft / self.warp
        coupling = self.poisson * self.weft / d
        return np.array([[self.warp / d, coupling, 0.0], [coupling, self.weft / d, 0.0],
                         [0.0, 0.0, self.shear]])

    def scaled(self, factor: float) -> "OrthotropicStVK":
        return replace(self, **{k: factor * getattr(self, k) for k in ("warp", "weft", "shear")})


@dataclass(frozen=True)
class Guarded:
    """A membrane that is nearly free of stress in a band of small strains, against locking.

    Flat triangles cannot follow a surface bent in two directions without stretching a little. With
    a stiff membrane that stretch outweighs the bending energy and the cloth folds too little.
    Feng et al. 2022 (section 4.1) therefore let cloth deform freely between 99 % and 101 % by
    updating its reference state during the simulation. In their final state only the strain e
    beyond the band, the *excess*, stores energy. Here this is an energy,

        r psi(e) + (1 - r) psi(excess(e)),

    so that an equilibrium is the minimum of one function, which does not depend on the path.
    The excess has continuous second derivatives. With r = 0, flat cloth without load could deform
    freely within the band and no equilibrium would be unique.

    The band limits the principal stretches of a corotational membrane, else warp, weft and shear.

    Attributes:
        membrane: material outside the band.
        low, high: stretches that bound the band; 99 % and 101 % in the paper.
        share: r, fraction of the membrane's stiffness within the band.
    """

    membrane: Corotational | OrthotropicStVK = field(
        default_factory=lambda: Corotational(stiffness=5000.0))
    low: float = 0.99
    high: float = 1.01
    share: float = 0.02

    def __post_init__(self) -> None:
        if not 0 < self.low < 1 < self.high < np.inf:
            raise InputError(f"free stretch from {self.low:g} to {self.high:g} must contain 1")
        if not 0 < self.share < 1:
            raise InputError(f"share={self.share:g} must lie between 0 and 1")
        if not isinstance(self.membrane, _Linear):
            raise InputError(f"membrane={self.membrane!r} cannot be guarded; give one such as "
                             "Corotational()")

    def energy(self, mesh: Mesh, active: np.ndarray) -> Energy:
        return StrainMembrane(mesh, active, self.membrane.of_green_strain(self))

    def scaled(self, factor: float) -> "Guarded":
        return replace(self, membrane=self.membrane.scaled(factor))

    def density(self, strain: np.ndarray) -> np.ndarray:
        inner, outer = self.membrane.density(strain), self.membrane.density(self.excess(strain)[0])
        return self.share * inner + (1 - self.share) * outer

    def stress(self, strain: np.ndarray) -> np.ndarray:
        excess, slope, _ = self.excess(strain)
        outer = slope * self.membrane.stress(excess)
        return self.share * self.membrane.stress(strain) + (1 - self.share) * outer

    def tangent(self, strain: np.ndarray) -> np.ndarray:
        excess, slope, bend = self.excess(strain)
        outer = slope[:, :, None] * self.membrane.tangent(excess) * slope[:, None, :]
        diagonal = np.arange(strain.shape[1])
        outer[:, diagonal, diagonal] += bend * self.membrane.stress(excess)
        return self.share * self.membrane.tangent(strain) + (1 - self.share) * outer

    def excess(self, strain: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Strain (N, K) beyond the band and its first two derivatives, componentwise."""
        low, high = self.membrane.band(self.low, self.high)
        above, below = _ramp(strain / high), _ramp(strain / low)
        return (high * above[0] + low * below[0], above[1] + below[1],
                above[2] / high + below[2] / low)


def _ramp(x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """max(x - 1, 0), smoothed over a width around 1, and its first two derivatives."""
    width = _ROUNDING_WIDTH
    u = np.clip((x - 1) / width + 0.5, 0.0, 1.0)
    value = width * u**3 * (1 - 0.5 * u) + np.maximum(x - 1 - 0.5 * width, 0.0)
    return value, u * u * (3 - 2 * u), 6 * u * (1 - u) / width


def _check_positive(**values: float) -> None:
    for name, value in values.items():
        if not (np.isfinite(value) and value > 0):
            raise InputError(f"{name}={value:g} must be a positive number of N/m")
