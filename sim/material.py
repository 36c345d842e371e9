"""Fabrics: the six bending moduli, their scaling with density, and the torque law.

Moduli are per unit width: a linear modulus alpha in N·m and a quadratic modulus beta in N·m²
for each of the directions warp, bias (45°) and weft. The torque per width of cloth bent to the
curvature kappa is ``alpha*kappa + beta*kappa**2`` (Feng et al. 2022, section 4.2.1).

Nearly all measured fabrics have beta < 0, so that the parabola peaks at
``kappa = alpha / (2*|beta|)``, often within the curvatures of a drape. It is followed up to the
fraction ``SOFTENING_LIMIT`` of ``alpha/|beta|`` and continued with the slope it has there; see
:func:`bending_work` and ``docs/physics.md``.
"""

from dataclasses import dataclass, field

import numba
import numpy as np

from common.errors import InputError

WARP, BIAS, WEFT = 0, 1, 2
DIRECTIONS = ("warp", "bias", "weft")
REFERENCE_DENSITY = 0.3  # kg/m²; a drape depends on moduli/density only (section 5.1.2)

MICRO = 1e-6  # N·m per µN·m
NANO = 1e-9  # N·m² per nN·m²

SOFTENING_LIMIT = 0.35
"""u_c: the reduced curvature u = -beta*kappa/alpha beyond which the torque grows linearly with
the slope 1 - 2*u_c of the parabola at u_c, so that a fabric never loses all stiffness."""

TWIST_FLOOR = 0.05
"""Least twisting stiffness A66 as a fraction of sqrt(A11*A22), see :func:`plate_constants`."""


@dataclass(frozen=True, eq=False)
class Fabric:
    """Bending moduli and density of a fabric.

    Attributes:
        alpha: (3,) linear moduli, N·m, in the order warp, bias, weft.
        beta: (3,) quadratic moduli, N·m², same order.
        density: mass per area, kg/m².

    Raises:
        InputError: a modulus or the density is not finite, an alpha or the density is not
            positive, or no elastic plate has these three linear moduli.
    """

    alpha: np.ndarray
    beta: np.ndarray = field(default_factory=lambda: np.zeros(3))
    density: float = REFERENCE_DENSITY

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Fabric) and self._key == other._key

    def __hash__(self) -> int:
        return hash(self._key)

    @property
    def _key(self) -> tuple[float, ...]:
        return *self.alpha.tolist(), *self.beta.tolist(), self.density

    def __post_init__(self) -> None:
        alpha, beta = (np.asarray(v, dtype=np.float64) for v in (self.alpha, self.beta))
        object.__setattr__(self, "alpha", alpha)
        object.__setattr__(self, "beta", beta)
        object.__setattr__(self, "density", float(self.density))
        if alpha.shape != (3,) or beta.shape != (3,):
            raise InputError("alpha and beta need three values each: warp, bias, weft")
        if not (np.isfinite(alpha).all() and np.isfinite(beta).all()):
            raise InputError("alpha and beta must be finite numbers")
        if not (np.isfinite(self.density) and self.density > 0):
            raise InputError(f"density must be positive, not {self.density * 1e3:g} g/m²")
        if alpha.min() <= 0:
            raise InputError("every linear modulus alpha must be positive")
        if not is_admissible(alpha, beta):
            raise InputError(
                "no elastic plate is this soft along the bias: alpha_bias must exceed "
                f"{bias_limit(alpha) / MICRO:.3g} µN·m for these warp and weft moduli"
            )

    def at_density(self, density: float) -> "Fabric":
        """The fabric of another density (kg/m²) that drapes the same: moduli scale with it."""
        scale = density / self.density
        return Fabric(alpha=self.alpha * scale, beta=self.beta * scale, density=density)


def bias_limit(alpha: np.ndarray) -> float:
    """Least alpha_bias (N·m) for which a positive-definite plate exists; see plate_constants."""
    a11, a22 = alpha[WARP], alpha[WEFT]
    return float((np.sqrt(a11) - np.sqrt(a22)) ** 2 / 4)


def is_admissible(alpha: np.ndarray, beta: np.ndarray) -> bool:
    """Whether moduli alpha (3,) N·m and beta (3,) N·m² belong to a stable plate.

    All of alpha must be positive and alpha_bias above :func:`bias_limit`. Any finite beta is
    admissible, because the torque is continued monotonically.
    """
    alpha, beta = np.asarray(alpha, float), np.asarray(beta, float)
    if not (np.isfinite(alpha).all() and np.isfinite(beta).all() and alpha.min() > 0):
        return False
    return bool(alpha[BIAS] > bias_limit(alpha) * (1 + 1e-9))


def plate_constants(alpha: np.ndarray) -> tuple[float, float, float, float]:
    """Orthotropic plate (A11, A22, A12, A66), N·m, with the moduli alpha (3,) N·m.

    The energy per area 1/2 (A11 Sxx² + A22 Syy² + 2 A12 Sxx Syy + 4 A66 Sxy²) of the curvature
    S must give alpha_warp, alpha_weft and alpha_bias for cylinders bent along 0°, 90° and 45°:
    A11 = alpha_warp, A22 = alpha_weft and

        2 A12 + 4 A66 = c,  c = 4 alpha_bias - alpha_warp - alpha_weft,

    which leaves one constant free. The rule: A12 = 0 and A66 = c/4, unless that falls below a
    small positive floor; then A66 is the floor and A12 = (c - 4 A66)/2 is negative. The floor,
    ``TWIST_FLOOR`` * sqrt(A11 A22), shrinks where it must for the form to stay positive
    definite. Everything is continuous in alpha.
    """
    a11, a22 = float(alpha[WARP]), float(alpha[WEFT])
    c = 4 * float(alpha[BIAS]) - a11 - a22
    mean = np.sqrt(a11 * a22)
    floor = min(TWIST_FLOOR * mean, (c / 2 + mean) / 4)
    a66 = max(c / 4, floor)
    return a11, a22, (c - 4 * a66) / 2, a66


def torque(curvature: np.ndarray, alpha: float, beta: float) -> np.ndarray:
    """Torque per width (N) at ``curvature`` >= 0 (1/m), see :func:`bending_work`."""
    return bending_work(curvature, alpha, beta)[1]


def bending_work(
    curvature: np.ndarray, alpha: np.ndarray, beta: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Energy per area (J/m²), torque per width (N) and tangent (N·m) of cloth bent one way.

    The torque alpha kappa + beta kappa² at ``curvature`` >= 0 (1/m), any shape, continued with its
    own slope once u = -beta kappa/alpha exceeds :data:`SOFTENING_LIMIT`.
    """
    kappa = np.asarray(curvature, dtype=np.float64)
    u = -beta / alpha * kappa
    # In reduced curvature the parabola is u (1 - u); beyond the limit its u² stops growing
    # quadratically, which adds `beyond²` back.
    beyond = np.maximum(u - SOFTENING_LIMIT, 0.0)
    over = np.where(beyond > 0, u, 1.0)
    return (
        alpha * kappa**2 * (0.5 - u / 3 + beyond**3 / (3 * over**2)),
        alpha * kappa * (1 - u + beyond**2 / over),
        alpha * (1 - 2 * u + 2 * beyond),
    )


@numba.njit(inline="always")
def softening_shape(u, limit):
    """H(u) = 2 e(u)/u² and its two derivatives, e the integral of the reduced torque.

    The energy per area of :func:`bending_work` is alpha kappa² H(u)/2.
    """
    if u <= limit:
        return 1.0 - 2.0 * u / 3.0, -2.0 / 3.0, 0.0
    # e(u) = s u²/2 + c u + d with the slope s and continuity at the limit
    s = 1.0 - 2.0 * limit
    c = limit * limit
    d = -limit * limit * limit / 3.0
    v = 1.0 / u
    return (
        s + 2.0 * v * (c + d * v),
        -2.0 * v * v * (c + 2.0 * d * v),
        4.0 * v * v * v * (c + 3.0 * d * v),
    )
