"""Fabrics: the six bending moduli, their scaling with density, and the bending law.

Moduli are per unit width: a linear modulus alpha in N·m and a quadratic modulus beta in N·m²
for each of the directions warp, bias (45°) and weft. The torque per width of cloth bent to the
curvature kappa is ``alpha*kappa + beta*kappa**2`` (Feng et al. 2022, section 4.2.1).

The law follows this parabola up to the fraction :data:`SOFTENING_LIMIT` of ``alpha/|beta|`` and
continues with its slope there; see :func:`softening_shape` and ``docs/physics.md``.
"""

from copy import copy
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from common.arguments import number, numbers
from common.errors import InputError
from common.types import Density, Metres, Moduli, QuadraticModuli
from sim.rig import GRAVITY

WARP, BIAS, WEFT = 0, 1, 2
DIRECTIONS = ("warp", "bias", "weft")
STIFF_SOFT = ("stiff", "bias", "soft")
LINEAR, RATIO = slice(0, 3), slice(3, 6)
"""Log alphas and beta/alpha in theta, the six coordinates of a fabric."""
FIRST, SECOND = 0, 2  # log alphas of the two yarns in theta
SWAPPED = [2, 1, 0, 5, 4, 3]
"""Indices that exchange the two yarns in theta."""
DRAPE_CURVATURE = 60.0
"""Curvature, 1/m, whose secant is the constant modulus that drapes as the cloth does
(docs/validation/secants.json)."""
KES_CURVATURE = 100.0
"""Curvature, 1/m, at which 2HB is read."""
MEMBRANE_STIFFNESS = 200.0  # N/m, of cloth of which nothing is stated
REFERENCE_DENSITY = 0.3  # kg/m²; a drape depends on moduli/density only (section 5.1.2)

MICRO = 1e-6  # N·m per µN·m
NANO = 1e-9  # N·m² per nN·m²

DENSITY_RANGE = (5e-3, 5.0)
"""kg/m²; values beyond this limit or the next two indicate a wrong unit."""
ALPHA_RANGE = (1e-9, 1.0)  # N·m
MAX_RATIO = 0.5
"""Largest |beta|/alpha, m; in fabrics it is about 2 mm."""
_LONGEST = 1.0  # m, gravity length

SOFTENING_LIMIT = 0.35
"""u_c: the reduced curvature u = -beta*kappa/alpha beyond which the torque grows linearly with
the slope 1 - 2*u_c of the parabola at u_c, so that the tangent stiffness stays positive."""

TWIST_FLOOR = 0.05
"""Smallest twisting stiffness A66 as a fraction of sqrt(A11*A22), see :func:`plate_constants`."""


@dataclass(frozen=True, eq=False, init=False, repr=False)
class Fabric:
    """Bending moduli and density of a fabric, compared by value. Moduli may be given as lists.
    InputError if no elastic plate has such moduli, or a value indicates a wrong unit. The arrays
    are read-only."""

    alpha: Moduli
    beta: QuadraticModuli
    density: Density

    def __init__(self, alpha: ArrayLike, beta: ArrayLike = (0.0, 0.0, 0.0),
                 density: Density = REFERENCE_DENSITY) -> None:
        alpha, beta = (numbers(name, values, "three finite numbers: warp, bias, weft", (3,))
                       for name, values in (("alpha", alpha), ("beta", beta)))
        self._set(alpha, beta, checked_density(density))
        _check_alpha(alpha)
        for value in beta[np.abs(beta) > MAX_RATIO * alpha].tolist():
            raise InputError(f"beta={value / NANO:g} nN·m² ({value:g} N·m²) is outside the range "
                             f"of fabrics: |beta|/alpha exceeds {MAX_RATIO:g} m; check the unit")
        if not is_admissible(alpha, beta):
            raise InputError("no elastic plate is this soft along the bias: alpha_bias must exceed "
                             f"{float(bias_limit(alpha)) / MICRO:.3g} µN·m for these warp and weft "
                             "moduli")

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Fabric) and self._values == other._values

    def __hash__(self) -> int:
        return hash(self._values)

    @property
    def _values(self) -> tuple[float, ...]:
        return (*self.alpha.tolist(), *self.beta.tolist(), self.density)

    def at_density(self, density: Density) -> "Fabric":
        """The fabric of another density with the same drape: moduli scale with it."""
        density = checked_density(density)
        scale, scaled = density / self.density, copy(self)
        scaled._set(self.alpha * scale, self.beta * scale, density)  # units checked before
        return scaled

    def __repr__(self) -> str:
        alpha, beta = (", ".join(f"{value:.4g}" for value in moduli + 0.0)
                       for moduli in (self.alpha / MICRO, self.beta / NANO))
        return f"Fabric(alpha [{alpha}] µN·m, beta [{beta}] nN·m², {1e3 * self.density:g} g/m²)"

    def _set(self, alpha: np.ndarray, beta: np.ndarray, density: Density) -> None:
        for name, values in (("alpha", alpha), ("beta", beta)):
            moduli = values.copy()
            moduli.flags.writeable = False
            object.__setattr__(self, name, moduli)
        object.__setattr__(self, "density", density)


def checked_density(density: object) -> Density:
    """A density; InputError for one outside :data:`DENSITY_RANGE`, such as one in g/m²."""
    value, (low, high) = number("density", density, "kg/m²"), DENSITY_RANGE
    if low <= value <= high:
        return value
    raise InputError(f"density={1e3 * value:g} g/m² ({value:g} kg/m²) is outside the range of "
                     f"fabrics, {1e3 * low:g} to {1e3 * high:g} g/m²; check the unit")


def _check_alpha(alpha: np.ndarray) -> None:
    low, high = ALPHA_RANGE
    for value in alpha[(alpha < low) | (alpha > high)].tolist():
        raise InputError(f"alpha={value / MICRO:g} µN·m ({value:g} N·m) is outside the range of "
                         f"fabrics, {low / MICRO:g} to {high / MICRO:g} µN·m; check the unit")


def bias_limit(alpha: np.ndarray) -> np.ndarray:
    """Lower bound of alpha_bias (...,), N·m, for a positive-definite plate with ``alpha`` (..., 3);
    see :func:`plate_constants`."""
    return (np.sqrt(alpha[..., WARP]) - np.sqrt(alpha[..., WEFT])) ** 2 / 4


def is_admissible(alpha: np.ndarray, beta: np.ndarray) -> np.ndarray:
    """(...,) bool: whether moduli alpha (..., 3) N·m and beta (..., 3) N·m² are those of a stable
    plate. Any finite beta is admissible, because the torque is continued monotonically."""
    alpha, beta = np.asarray(alpha, float), np.asarray(beta, float)
    finite = np.isfinite(alpha).all(axis=-1) & np.isfinite(beta).all(axis=-1)
    sound = finite & (alpha.min(axis=-1) > 0)
    possible = np.where(sound[..., None], alpha, 1.0)
    return sound & (possible[..., BIAS] > bias_limit(possible) * (1 + 1e-9))


def plate_constants(alpha: Moduli) -> tuple[float, float, float, float]:
    """Orthotropic plate (A11, A22, A12, A66), N·m, with these moduli.

    The energy per area 1/2 (A11 Sxx² + A22 Syy² + 2 A12 Sxx Syy + 4 A66 Sxy²) of the curvature
    S must give alpha_warp, alpha_weft and alpha_bias for cylinders bent along 0°, 90° and 45°:
    A11 = alpha_warp, A22 = alpha_weft and

        2 A12 + 4 A66 = c,  c = 4 alpha_bias - alpha_warp - alpha_weft,

    which does not determine one constant. The rule: A12 = 0 and A66 = c/4, unless that falls below
    a small positive floor; then A66 is the floor and A12 = (c - 4 A66)/2 is negative. The floor is
    ``TWIST_FLOOR`` * sqrt(A11 A22), or less where the form would not be positive definite.
    All constants are continuous in alpha.
    """
    a11, a22 = float(alpha[WARP]), float(alpha[WEFT])
    c = 4 * float(alpha[BIAS]) - a11 - a22
    mean = np.sqrt(a11 * a22)
    floor = min(TWIST_FLOOR * mean, (c / 2 + mean) / 4)
    a66 = max(c / 4, floor)
    return a11, a22, (c - 4 * a66) / 2, a66


def gravity_length(alpha: float, density: Density) -> Metres:
    """(alpha/rho g)^⅓ of a modulus in N·m: the scale of the narrowest folds of cloth that is as
    stiff. Strips of 1.5 and 2.5 such lengths, which drop by 0.4 and 1.5 times their reach,
    determine alpha and beta well."""
    cubed = number("alpha", alpha, "N·m") / (checked_density(density) * GRAVITY)
    if not 0 < cubed <= _LONGEST**3:
        raise InputError(f"alpha={alpha:g} N·m must be positive and give a gravity length of at "
                         f"most {_LONGEST:g} m; check the unit")
    return cubed ** (1 / 3)


def softening_shape(u, limit):
    """H, dH/du and d²H/du² at the reduced curvature u, a number or an array.

    The energy per area of cloth bent to the curvature kappa is alpha kappa² H(u)/2, H = 1 - 2 u/3
    up to ``limit``; beyond it the linear torque adds 2 (u - limit)³/(3 u²).
    """
    over = np.maximum(u, limit)
    beyond = over - limit
    share = beyond / over
    return (1.0 - 2.0 / 3.0 * (u - share * share * beyond),
            -2.0 / 3.0 * (1.0 - share * share * (3.0 - 2.0 * share)),
            4.0 * share * (1.0 - share) ** 2 / over)


def bending_work(
    curvature: np.ndarray | float, alpha: np.ndarray | float, beta: np.ndarray | float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Energy per area (J/m²), torque per width (N) and tangent (N·m) of cloth bent one way, for
    curvature (1/m, at least 0), alpha (N·m) and beta (N·m²) of any shapes that broadcast."""
    kappa = np.asarray(curvature, dtype=np.float64)
    u = -beta / alpha * kappa
    shape, slope, bend = softening_shape(u, SOFTENING_LIMIT)
    return (0.5 * alpha * kappa**2 * shape, alpha * kappa * (shape + 0.5 * u * slope),
            alpha * (shape + 2.0 * u * slope + 0.5 * u**2 * bend))


def torque(
    curvature: np.ndarray | float, alpha: np.ndarray | float, beta: np.ndarray | float
) -> np.ndarray:
    """Torque per width (N); arguments as for :func:`bending_work`."""
    curvature, alpha, beta = (numbers(name, values, "finite numbers") for name, values in (
        ("curvature", curvature), ("alpha", alpha), ("beta", beta)))
    if (curvature < 0).any() or (alpha <= 0).any():
        raise InputError("curvatures (1/m) must not be negative, and alpha (N·m) must be positive")
    return bending_work(curvature, alpha, beta)[1]


def secant(
    curvature: float, alpha: np.ndarray | float, beta: np.ndarray | float
) -> np.ndarray:
    """Torque per width over ``curvature`` (1/m), N·m: alpha + beta*curvature within the law, alpha
    at zero; never negative, because the torque is continued with a positive slope. ``alpha`` and
    ``beta`` as for :func:`bending_work`; InputError as for :func:`torque`."""
    if curvature == 0:
        return np.array(alpha, dtype=np.float64)
    return torque(np.asarray(curvature), alpha, beta) / curvature
