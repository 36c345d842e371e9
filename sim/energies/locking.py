"""A guard against locking: strain within a band around rest costs nearly nothing.

Flat triangles cannot follow a surface bent in two directions without stretching a little. With a
stiff membrane that stretch outweighs the bending energy and the cloth folds less than it should.
Feng et al. 2022 (section 4.1) therefore let cloth deform freely between 99 % and 101 % by moving
its reference state along during the simulation. Where that procedure comes to rest, the reference
is the state nearest to the current one that the band allows, and only the rest of the strain, the
*excess*, stores energy. The guard is that state of rest written as an energy,

    r psi(e) + (1 - r) psi(excess(e)),

so that an equilibrium stays the minimum of one function, which does not depend on the path, and
Newton's method keeps its proof of a minimum. A lagged reference has neither. The excess has
continuous second derivatives: it is zero well inside the band and e minus the limit well outside.
The small share r of the stiffness stays everywhere; without it flat cloth without load could
flow within the band and no equilibrium would be unique.
"""

from dataclasses import dataclass

import numpy as np

from sim.energies.strain import StrainLaw

_ROUNDED = 0.5  # width of the bend at each limit of the band, as a share of half the band
_ROUND = 1e-9  # difference of principal strains below which they count as equal


@dataclass(frozen=True)
class Band:
    """Strains that are free, with the law's share that remains there.

    Attributes:
        low, high: limits, low < 0 < high; numbers or one for each component of the strain.
        share: of the stiffness within the band, above 0.
    """

    low: np.ndarray | float
    high: np.ndarray | float
    share: float

    def excess(self, strain: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Strain beyond the band and its first two derivatives, each shaped like ``strain``."""
        above = _ramp(strain / self.high)
        below = _ramp(strain / self.low)
        return (
            self.high * above[0] + self.low * below[0],
            above[1] + below[1],
            above[2] / self.high + below[2] / self.low,
        )


def _ramp(x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """max(x - 1, 0), rounded over a width around 1, and its first two derivatives."""
    width = _ROUNDED
    u = np.clip((x - 1) / width + 0.5, 0.0, 1.0)
    value = width * u**3 * (1 - 0.5 * u) + np.maximum(x - 1 - 0.5 * width, 0.0)
    return value, u * u * (3 - 2 * u), 6 * u * (1 - u) / width


class ComponentGuard:
    """A strain law whose components (warp, weft, shear) are free within a band each.

    For woven cloth, whose law names these directions.

    Args:
        law: what stays outside the band, :class:`sim.energies.strain.StrainLaw`.
        band: limits (3,) of E_uu, E_vv and 2 E_uv.
    """

    def __init__(self, law: StrainLaw, band: Band) -> None:
        self._law, self._band = law, band

    def density(self, strain: np.ndarray) -> np.ndarray:
        share, (excess, _, _) = self._band.share, self._band.excess(strain)
        return share * self._law.density(strain) + (1 - share) * self._law.density(excess)

    def stress(self, strain: np.ndarray) -> np.ndarray:
        share, (excess, slope, _) = self._band.share, self._band.excess(strain)
        return share * self._law.stress(strain) + (1 - share) * slope * self._law.stress(excess)

    def tangent(self, strain: np.ndarray) -> np.ndarray:
        share, (excess, slope, bend) = self._band.share, self._band.excess(strain)
        outside = slope[:, :, None] * self._law.tangent(excess) * slope[:, None, :]
        diagonal = np.arange(3)
        outside[:, diagonal, diagonal] += bend * self._law.stress(excess)
        return share * self._law.tangent(strain) + (1 - share) * outside


class PrincipalGuard:
    """The isotropic corotational law, free within a band of its principal stretches.

    psi(s) = mu (e1² + e2²) + lambda/2 (e1 + e2)² with e = s - 1, s the singular values of F, as
    in :class:`sim.energies.membrane.CorotationalMembrane`; s = sqrt(1 + 2 E) of the principal
    Green strains E makes it a strain law.

    Args:
        stiffness: Young's modulus times thickness, N/m.
        poisson: Poisson's ratio in the plane.
        band: limits of s - 1.
    """

    def __init__(self, *, stiffness: float, poisson: float, band: Band) -> None:
        self._mu = stiffness / (2 * (1 + poisson))
        self._lam = stiffness * poisson / (1 - poisson**2)
        self._band = band

    def density(self, strain: np.ndarray) -> np.ndarray:
        e = _principal(strain)[0] - 1
        share, (excess, _, _) = self._band.share, self._band.excess(e)
        return share * self._psi(e) + (1 - share) * self._psi(excess)

    def stress(self, strain: np.ndarray) -> np.ndarray:
        s, cos, sin = _principal(strain)
        q1, q2 = (self._force(s) / s).T
        mean, half = (q1 + q2) / 2, (q1 - q2) / 2
        return np.column_stack([mean + half * cos, mean - half * cos, half * sin])

    def tangent(self, strain: np.ndarray) -> np.ndarray:
        s, cos, sin = _principal(strain)
        q = self._force(s) / s
        Q = self._stiffness(s) / (s[:, :, None] * s[:, None, :])
        Q[:, 0, 0] -= q[:, 0] / s[:, 0] ** 2
        Q[:, 1, 1] -= q[:, 1] / s[:, 1] ** 2
        # Principal strains by components of the strain, and the direction that turns them
        first = np.column_stack([(1 + cos) / 2, (1 - cos) / 2, sin / 2])
        second = np.column_stack([(1 - cos) / 2, (1 + cos) / 2, -sin / 2])
        turn = np.column_stack([-sin / 2, sin / 2, cos / 2])
        gap = (s[:, 0] ** 2 - s[:, 1] ** 2) / 2
        apart = gap > _ROUND
        turning = 2 * np.where(
            apart, (q[:, 0] - q[:, 1]) / np.where(apart, gap, 1.0), Q[:, 0, 0] - Q[:, 0, 1]
        )
        axes = np.stack([first, second], axis=1)  # (N, 2, 3)
        result = np.einsum("nai,nab,nbj->nij", axes, Q, axes)
        return result + turning[:, None, None] * turn[:, :, None] * turn[:, None, :]

    def _psi(self, e: np.ndarray) -> np.ndarray:
        return self._mu * (e**2).sum(1) + 0.5 * self._lam * e.sum(1) ** 2

    def _linear(self, e: np.ndarray) -> np.ndarray:
        """Derivative (N, 2) of psi by e."""
        return 2 * self._mu * e + self._lam * e.sum(1, keepdims=True)

    def _force(self, s: np.ndarray) -> np.ndarray:
        """Derivative (N, 2) of the guarded energy by the stretches."""
        share, (excess, slope, _) = self._band.share, self._band.excess(s - 1)
        return share * self._linear(s - 1) + (1 - share) * slope * self._linear(excess)

    def _stiffness(self, s: np.ndarray) -> np.ndarray:
        """Second derivatives (N, 2, 2) of the guarded energy by the stretches."""
        share, (excess, slope, bend) = self._band.share, self._band.excess(s - 1)
        plain = 2 * self._mu * np.eye(2) + self._lam
        outside = slope[:, :, None] * plain * slope[:, None, :]
        diagonal = np.arange(2)
        outside[:, diagonal, diagonal] += bend * self._linear(excess)
        return share * plain + (1 - share) * outside


def _principal(strain: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Stretches (N, 2), larger first, and cosine and sine (N,) of twice the first's angle."""
    mean = (strain[:, 0] + strain[:, 1]) / 2
    half, shear = (strain[:, 0] - strain[:, 1]) / 2, strain[:, 2] / 2
    radius = np.hypot(half, shear)
    squares = 1 + 2 * np.column_stack([mean + radius, mean - radius])
    stretches = np.sqrt(np.maximum(squares, 1e-24))
    safe = np.where(radius > 0, radius, 1.0)
    return stretches, np.where(radius > 0, half / safe, 1.0), shear / safe
