"""The heavy elastica: the shape of a clamped strip that bends in a plane, without a mesh.

Lengths in units of the strip's length, with s from the clamp, theta the angle below the
horizontal and m the torque divided by alpha:

    theta' = kappa(m),  m' = -gamma (1 - s) cos(theta),  theta(0) = slope,  m(1) = 0,

gamma = rho g L³/alpha and kappa(m) the inverse of the torque law of :func:`sim.material.torque`.
For a linear law this is theta'' = -gamma (1 - s) cos(theta).
"""

import numba
import numpy as np
from scipy.integrate import cumulative_trapezoid, solve_bvp
from scipy.optimize import brentq

from common.errors import InputError
from sim.material import SOFTENING_LIMIT

LARGEST_GAMMA = 1e4
STEPS = 2000
"""Least number of steps along a strip; the error of H/W is then below 1e-7."""

_SMALLEST_TIP = -300.0  # logarithm of the tip's angle to the vertical; far below any solution's


def elastica(
    gamma: float,
    points: int = 2001,
    *,
    softening: float = 0.0,
    slope: float = 0.0,
    steps: int = STEPS,
) -> np.ndarray:
    """Shape (points, 2) of a heavy elastica of length 1: distance from the clamp and drop.

    For small gamma and a horizontal clamp, drop/reach tends to gamma/8.

    Args:
        gamma: rho g L³/alpha, up to :data:`LARGEST_GAMMA`.
        points: at equal distances along the strip.
        softening: -beta/(alpha L); 0 is the linear law.
        slope: angle of the clamp below the horizontal, radians in [0, pi/2).
        steps: least number of steps of the integration; with 400 H/W is still right to 1e-5
            up to gamma = 1000.

    Raises:
        InputError: gamma or slope out of range.
    """
    if not 0 < gamma <= LARGEST_GAMMA:
        raise InputError(f"gamma={gamma:g} must lie above 0 and not above {LARGEST_GAMMA:g}")
    if not 0 <= slope < np.pi / 2 - 1e-3:
        raise InputError(f"the clamp must slope by 0 to 89 degrees, not {np.degrees(slope):g}")
    every = -(-steps // (points - 1))
    return _shoot(float(gamma), float(softening), SOFTENING_LIMIT, float(slope), points, every)


def heavy_elastica(
    alpha: float,
    beta: float,
    *,
    weight: float,
    length: float,
    slope: float = 0.0,
    points: int = 2001,
    steps: int = STEPS,
) -> np.ndarray:
    """Shape (points, 2), m, of a strip whose torque is that of :func:`sim.material.torque`.

    Args:
        alpha, beta: moduli along the strip, N·m and N·m².
        weight: rho g, N/m².
        length: free length, m.
        slope, points, steps: as for :func:`elastica`.
    """
    gamma = weight * length**3 / alpha
    softening = -beta / (alpha * length)
    return length * elastica(gamma, points, softening=softening, slope=slope, steps=steps)


def elastica_of_torque(
    curvature: np.ndarray, torque: np.ndarray, *, weight: float, length: float, points: int = 2001
) -> np.ndarray:
    """Shape (points, 2), m, of a strip with any increasing torque law, by collocation.

    Slower and less exact than :func:`heavy_elastica`, for laws that are no parabola.

    Args:
        curvature: (K,) 1/m, from 0 beyond the largest of the strip.
        torque: (K,) N, per width at these curvatures, increasing.
        weight: rho g, N/m².
        length: free length, m.

    Raises:
        InputError: a torque that does not increase, or no solution found.
    """
    if not (np.diff(torque) > 0).all():
        raise InputError("the torque must increase with the curvature")
    gamma = weight * length**3 * (curvature[1] - curvature[0]) / (torque[1] - torque[0])
    layer = 1 / np.sqrt(1 + gamma)  # at the clamp, in which the strip turns downwards

    def slope(s: np.ndarray, y: np.ndarray) -> np.ndarray:
        turn = length * np.interp(y[1], torque, curvature)
        return np.stack([turn, -weight * length**2 * (1 - s) * np.cos(y[0])])

    s = np.unique(np.r_[np.linspace(0, min(1, 10 * layer), 200), np.linspace(0, 1, 200)])
    fall = np.exp(-s / layer)
    drooping = np.pi / 2 * gamma / (gamma + 10)
    guess = drooping * np.stack([1 - fall, weight * length**2 / gamma * fall / layer])
    solution = solve_bvp(
        slope, lambda clamp, tip: np.array([clamp[0], tip[1]]), s, guess,
        tol=1e-7, max_nodes=100_000,
    )  # fmt: skip
    if not solution.success:
        raise InputError(f"no shape of the strip was found: {solution.message}")
    at = np.linspace(0, 1, 20 * (points - 1) + 1)
    angle = solution.sol(at)[0]
    shape = cumulative_trapezoid(np.stack([np.cos(angle), np.sin(angle)]), at, initial=0)
    return length * shape.T[::20]


def aspect_ratio(end: np.ndarray) -> float:
    """Drop over reach (H/W) of a deflected strip whose free end lies at ``end`` (2,)."""
    return float(end[1] / end[0])


def gamma_of_aspect_ratio(ratio: float) -> float:
    """The gamma at which the linear elastica with a horizontal clamp has this H/W.

    Raises:
        InputError: no gamma up to :data:`LARGEST_GAMMA` has.
    """

    def excess(log_gamma: float) -> float:
        return np.log(aspect_ratio(elastica(np.exp(log_gamma), 101)[-1]) / ratio)

    lowest, highest = np.log(1e-6), np.log(0.999 * LARGEST_GAMMA)
    if not ratio > 0 or excess(lowest) > 0 or excess(highest) < 0:
        raise InputError(f"no heavy elastica has drop/reach = {ratio:g}")
    return float(np.exp(brentq(excess, lowest, highest, xtol=1e-9)))


@numba.njit(cache=True)
def curvature_of_torque(m, softening, limit):
    """Curvature kappa at the torque m = tau/alpha >= 0, both 1/m, or both without unit.

    The inverse of kappa (1 - u), u = softening * kappa, up to u = ``limit``, and of its straight
    continuation beyond.
    """
    t = softening * m
    end = limit * (1.0 - limit)
    if t > end:
        return (limit + (t - end) / (1.0 - 2.0 * limit)) / softening
    return 2.0 * m / (1.0 + np.sqrt(1.0 - 4.0 * t))


@numba.njit(cache=True)
def _from_tip(gamma, softening, limit, tip, target, steps, every, shape):
    """Integrate from the tip to the clamp (Runge-Kutta, fourth order).

    The angle d = pi/2 - theta to the vertical is used, because at the tip of a limp strip it is
    too small to be told from 0 in theta. Fills ``shape`` if it has rows; returns d at the clamp,
    or where it passes ``target``.
    """
    h = 1.0 / steps
    d, m, x, y = tip, 0.0, 0.0, 0.0
    for i in range(steps):
        t = i * h
        d1, m1 = curvature_of_torque(m, softening, limit), gamma * t * np.sin(d)
        da = d + 0.5 * h * d1
        d2 = curvature_of_torque(m + 0.5 * h * m1, softening, limit)
        m2 = gamma * (t + 0.5 * h) * np.sin(da)
        db = d + 0.5 * h * d2
        d3 = curvature_of_torque(m + 0.5 * h * m2, softening, limit)
        m3 = gamma * (t + 0.5 * h) * np.sin(db)
        dc = d + h * d3
        d4 = curvature_of_torque(m + h * m3, softening, limit)
        m4 = gamma * (t + h) * np.sin(dc)
        if len(shape):
            x += h / 6 * (np.sin(d) + 2 * np.sin(da) + 2 * np.sin(db) + np.sin(dc))
            y += h / 6 * (np.cos(d) + 2 * np.cos(da) + 2 * np.cos(db) + np.cos(dc))
            if (i + 1) % every == 0:
                shape[(i + 1) // every, 0] = x
                shape[(i + 1) // every, 1] = y
        d += h / 6 * (d1 + 2 * d2 + 2 * d3 + d4)
        m += h / 6 * (m1 + 2 * m2 + 2 * m3 + m4)
        if d > target + 0.1:
            return d
    return d


@numba.njit(cache=True)
def _shoot(gamma, softening, limit, slope, points, every):
    """The shape (points, 2): bisection for the tip's angle that meets the clamp's slope.

    While theta stays between -pi/2 and pi/2 it grows from clamp to tip, and the clamp's angle
    grows with the tip's, so that the bracket holds exactly one solution.
    """
    steps = (points - 1) * every
    target = np.pi / 2 - slope
    none = np.empty((0, 2))
    low, high = _SMALLEST_TIP, np.log(target)
    while high - low > 1e-14 * (1.0 + abs(low)):
        middle = 0.5 * (low + high)
        if middle <= low or middle >= high:
            break
        reached = _from_tip(gamma, softening, limit, np.exp(middle), target, steps, every, none)
        if reached > target:
            high = middle
        else:
            low = middle
    shape = np.zeros((points, 2))
    tip = np.exp(0.5 * (low + high))
    _from_tip(gamma, softening, limit, tip, target, steps, every, shape)
    return shape[-1] - shape[::-1]
