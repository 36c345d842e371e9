"""The heavy elastica: plane bending of a clamped strip under its weight, without a mesh.

With s from the clamp, theta the angle below the horizontal and tau the torque per width:

    theta' = kappa(tau),  tau' = -rho g (L - s) cos(theta),  theta(0) = slope,  tau(L) = 0.

Torque laws kappa(tau) are arrays (4, K) of pieces tau = tau_k + a_k (kappa - kappa_k) +
b_k (kappa - kappa_k)²: curvature kappa_k, torque tau_k, slope a_k and quadratic coefficient b_k.
Curvatures and torques increase from 0; the last piece is unbounded. For a linear one and L = 1 the
equation is theta'' = -gamma (1 - s) cos(theta), gamma = rho g L³/alpha.
"""

import numba
import numpy as np
from scipy.optimize import brentq

from common.errors import InputError
from common.types import DeflectionCurve, Metres, Radians
from sim.material import SOFTENING_LIMIT

MAX_GAMMA = 1e4
MAX_RISE = np.radians(-10.0)  # of a clamp; strips that rise further may fall to either side
_MIN_LOG_TIP_ANGLE = -300.0  # of the tip's angle to the vertical; far below any solution
_CURLED_TIP_ANGLES = (-3.0, 3.0)  # the same, of a strip with natural curvature


def strip_shape(
    law: np.ndarray, *, weight: float, length: Metres, slope: Radians = 0.0, points: int = 2001,
    steps: int = 2000,
) -> DeflectionCurve:
    """Shape of a strip of any torque ``law`` (4, K), at equidistant points. The error of H/W is
    below 1e-7, with 400 ``steps`` of integration below 1e-5 up to gamma = 1000."""
    if not MAX_RISE <= slope < np.pi / 2 - 1e-3:
        raise InputError(f"the clamp must slope by {np.degrees(MAX_RISE):g} to 89 degrees, not "
                         f"{np.degrees(slope):g}")
    shape, target = np.zeros((points, 2)), np.pi / 2 - slope
    every = -(-steps // (points - 1))

    def excess(tip: float) -> float:
        angle = tip if curled else np.exp(tip)
        return _from_tip(law, weight, length, angle, target, every, shape) - target

    curled = law[1, 0] != 0  # the tip of such a strip may hang beyond the vertical, or rise
    low, high = _CURLED_TIP_ANGLES if curled else (_MIN_LOG_TIP_ANGLE, np.log(target))
    if excess(low) > 0:
        raise InputError("the cloth is too soft for its clamp: it hangs straight down")
    if excess(high) < 0:
        raise InputError("the cloth curls up so much that its strip does not hang")
    # With -pi/2 < theta < pi/2, theta grows from clamp to tip, and the clamp's angle grows with
    # the tip's: there is exactly one solution.
    excess(brentq(excess, low, high, xtol=1e-14, rtol=1e-14))
    return shape[-1] - shape[::-1]


def heavy_elastica(
    alpha: float, beta: float, *, weight: float, length: Metres, curl: float = 0.0, **options
) -> DeflectionCurve:
    """Shape of a strip with the torque law of :func:`sim.material.torque`, moduli in N·m and N·m²;
    ``curl``: natural curvature, 1/m, positive where it bends the strip down, as in
    :mod:`sim.energies.bending_variants`; options as for :func:`strip_shape`."""
    gamma = weight * length**3 / alpha
    if not 0 < gamma <= MAX_GAMMA:
        raise InputError(f"gamma={gamma:g} must lie above 0 and not above {MAX_GAMMA:g}")
    law = softening_law(alpha, beta)
    law[1] -= alpha * curl
    return strip_shape(law, weight=weight, length=length, **options)


def elastica(
    gamma: float, points: int = 2001, *, softening: float = 0.0, **options
) -> DeflectionCurve:
    """A heavy elastica of length 1 with -beta/(alpha L) = ``softening``. For small gamma and a
    horizontal clamp, drop/reach tends to gamma/8."""
    return heavy_elastica(1.0, -softening, weight=gamma, length=1.0, points=points, **options)


def softening_law(alpha: float, beta: float) -> np.ndarray:
    """Pieces (4, 1 or 2) of the law of :func:`sim.material.torque`; N·m and N·m²."""
    if beta >= 0:
        return np.array([[0.0], [0.0], [alpha], [beta]])
    end, u = SOFTENING_LIMIT * alpha / -beta, SOFTENING_LIMIT
    return np.array([[0, end], [0, alpha * end * (1 - u)], [alpha, alpha * (1 - 2 * u)], [beta, 0]])


def aspect_ratio(end: np.ndarray) -> float:
    """Drop over reach (H/W) of a deflected strip with the free end at ``end`` (2,), m."""
    return float(end[1] / end[0])


def gamma_of_aspect_ratio(ratio: float) -> float:
    """The gamma, up to :data:`MAX_GAMMA`, at which the linear elastica with a horizontal clamp has
    the H/W ``ratio``; InputError if there is none."""
    def excess(log_gamma: float) -> float:
        return aspect_ratio(elastica(np.exp(log_gamma), 101)[-1]) - ratio

    try:
        return float(np.exp(brentq(excess, np.log(1e-6), np.log(0.999 * MAX_GAMMA), xtol=1e-9)))
    except ValueError:  # no change of sign
        raise InputError(f"no heavy elastica has drop/reach = {ratio:g}") from None


@numba.njit(cache=True)
def curvature_of_torque(torque, law):
    """Curvature, 1/m, of a law (4, K) at a torque, N. The law is odd about its first point."""
    sign = 1.0 if torque >= law[1, 0] else -1.0
    torque = law[1, 0] + abs(torque - law[1, 0])
    k = max(np.searchsorted(law[1], torque, side="right") - 1, 0)
    over = torque - law[1, k]
    root = np.sqrt(law[2, k] ** 2 + 4.0 * law[3, k] * over)
    return sign * (law[0, k] + 2.0 * over / (law[2, k] + root))


@numba.njit(cache=True)
def _from_tip(law, weight, length, tip, target, every, shape):
    """Fill ``shape`` (points, 2) from tip to clamp by fourth-order Runge-Kutta steps, ``every`` of
    them between two points. Returns the angle to the vertical at the clamp, or beyond ``target``.

    The unknown is d = pi/2 - theta, as theta cannot resolve the tip of a very soft strip.
    """
    steps = (len(shape) - 1) * every
    h = length / steps
    d, m, x, y = tip, 0.0, 0.0, 0.0
    for i in range(steps):
        load, middle, end = weight * i * h, weight * (i + 0.5) * h, weight * (i + 1) * h
        d1, m1 = curvature_of_torque(m, law), load * np.sin(d)
        da = d + 0.5 * h * d1
        d2, m2 = curvature_of_torque(m + 0.5 * h * m1, law), middle * np.sin(da)
        db = d + 0.5 * h * d2
        d3, m3 = curvature_of_torque(m + 0.5 * h * m2, law), middle * np.sin(db)
        dc = d + h * d3
        d4, m4 = curvature_of_torque(m + h * m3, law), end * np.sin(dc)
        x += h / 6 * (np.sin(d) + 2 * np.sin(da) + 2 * np.sin(db) + np.sin(dc))
        y += h / 6 * (np.cos(d) + 2 * np.cos(da) + 2 * np.cos(db) + np.cos(dc))
        d += h / 6 * (d1 + 2 * d2 + 2 * d3 + d4)
        m += h / 6 * (m1 + 2 * m2 + 2 * m3 + m4)
        if (i + 1) % every == 0:
            shape[(i + 1) // every, 0], shape[(i + 1) // every, 1] = x, y
        if d > target + 0.1:
            return d
    return d
