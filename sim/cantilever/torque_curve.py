"""A free torque curve from deflection curves, in place of alpha and beta (after Miguel et al.).

Torque is a monotone cubic spline of the curvature, with a few knots; a
strip of that law is computed, from its tip to the clamp, and the knots move until it lies on the
measured ones: the equilibrium is part of the fit, nothing is differentiated twice.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numba
import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.optimize import brentq, least_squares

from common.errors import InputError
from sim.cantilever.curves import fit_bezier
from sim.cantilever.regression import NO_STRIP, torque_and_curvature
from sim.cantilever.table import distance_across

KNOTS = 4
POINTS = 41  # of each curve that are compared
_BEYOND = 1.25  # knots reach beyond the largest torque read, where a curve may bend further
_CROWDING = 1.7  # of the knots towards 0: most of a strip bends little
_SAMPLES = 4000  # of the law, for the strips
_STEPS = 10  # of the integration, between two points
_SMALLEST_TIP = -60.0  # logarithm of the tip's angle to the vertical
_SMOOTH = 0.02
"""Weight of the bends of log slope against distances in units of 1 % of the strip's length: enough
to hold knots that no strip reaches."""


@dataclass(frozen=True)
class TorqueCurve:
    """Torque per width as a monotone function of curvature.

    Attributes:
        curvature: (K + 1,) 1/m, the first 0. torque: (K + 1,) N, at these, increasing from 0.
        misfit: root mean square distance of the measured points from the fitted strips, relative
            to the mean length.
        reached: largest curvature on any strip, 1/m; beyond, the curve is a continuation.
    """

    curvature: np.ndarray
    torque: np.ndarray
    misfit: float
    reached: float

    def at(self, curvature: np.ndarray) -> np.ndarray:
        """Torque (N,) at curvatures (N,), 1/m, up to the last knot's."""
        return PchipInterpolator(self.curvature, self.torque)(curvature)


def fit_torque_curve(
    curves: Sequence[np.ndarray], *, weight: float, knots: int = KNOTS,
    degree: int | None = None,
) -> TorqueCurve:
    """The torque curve of one direction from its strips, clamped level.

    Args:
        curves: (N, 2) m, reach and drop, each, of strips of several lengths if possible.
        weight: rho g, N/m².
        knots: beside that at 0.
        degree: of the Bézier curves, see :func:`sim.cantilever.curves.fit_bezier`.

    Raises:
        InputError: fewer than 2 or more than 8 knots, or curves that no strip has.
    """
    if not 2 <= knots <= 8:
        raise InputError(f"knots={knots} must lie between 2 and 8")
    measured, lengths, read = [], [], []
    for curve in curves:
        bezier, _ = fit_bezier(curve, degree=degree)
        measured.append(bezier.at(bezier.evenly(POINTS)))
        lengths.append(bezier.length)
        read.append(torque_and_curvature(curve, weight=weight, degree=degree))
    torque, curvature = (np.concatenate(part) for part in zip(*read, strict=True))
    slope = float(torque @ curvature / (curvature @ curvature))
    if not slope > 0:
        raise InputError(NO_STRIP)
    # Knots at the curvatures, the torque free: a law's slope is a stiffness, positive as exp(x).
    places = _BEYOND * curvature.max() * np.linspace(0, 1, knots + 1) ** _CROWDING

    def law(x: np.ndarray) -> np.ndarray:
        return np.concatenate([[0.0], np.cumsum(slope * np.exp(x) * np.diff(places))])

    def strips(x: np.ndarray) -> list[np.ndarray]:
        at = np.linspace(0, places[-1], _SAMPLES)
        torques = PchipInterpolator(places, law(x))(at)
        even = np.linspace(0, torques[-1], _SAMPLES)
        table = np.interp(even, torques, at)
        return [_strip(table, even[1], weight, length) for length in lengths]

    def residuals(x: np.ndarray) -> np.ndarray:
        gaps = [(strip - points).ravel() / (0.01 * length)
                for strip, points, length in zip(strips(x), measured, lengths, strict=True)]
        return np.concatenate([*gaps, _SMOOTH * np.diff(x)])

    start = np.zeros(knots)
    found = least_squares(residuals, start, bounds=(-4.0, 3.0), diff_step=1e-4, xtol=1e-6,
                          ftol=1e-8, max_nfev=40)
    # From the points themselves: the Bézier curves, which the fit follows, have lost their noise.
    distances = np.concatenate([distance_across(curve, strip)
                                for curve, strip in zip(curves, strips(found.x), strict=True)])
    misfit = np.sqrt((distances**2).mean()) / np.mean(lengths)
    return TorqueCurve(places, law(found.x), float(misfit), float(curvature.max()))


def _strip(table: np.ndarray, step: float, weight: float, length: float) -> np.ndarray:
    """Shape (POINTS, 2), m, of a strip that hangs from a level clamp.

    Args:
        table: (N,) curvatures, 1/m, at torques every ``step`` from 0, N.
        weight: rho g, N/m². length: m.

    Raises:
        InputError: the law is so soft that any strip hangs straight down.
    """
    shape = np.zeros((POINTS, 2))
    def beyond_level(tip: float) -> float:
        return _from_tip(np.exp(tip), table, step, weight, length, shape) - np.pi / 2

    if beyond_level(_SMALLEST_TIP) > 0:
        raise InputError("no torque curve makes a strip hang like these from a level clamp; check "
                         "their axes and the clamp")
    # The angle at the clamp grows with that at the tip.
    tip = brentq(beyond_level, _SMALLEST_TIP, np.log(np.pi / 2), xtol=1e-12)
    _from_tip(np.exp(tip), table, step, weight, length, shape)
    return shape[-1] - shape[::-1]


@numba.njit(cache=True)
def _curvature(torque, table, step):
    """By linear interpolation, and straight on beyond the table."""
    place = torque / step
    k = min(int(place), len(table) - 2)
    return table[k] + (place - k) * (table[k + 1] - table[k])


@numba.njit(cache=True)
def _from_tip(tip, table, step, weight, length, shape):
    """Fill ``shape`` from the tip to the clamp; the angle to the vertical at the clamp.

    With t from the tip: angle' = curvature(torque), torque' = weight t sin(angle); midpoint rule.
    """
    h = length / ((len(shape) - 1) * _STEPS)
    angle, torque, x, y = tip, 0.0, 0.0, 0.0
    for i in range((len(shape) - 1) * _STEPS):
        t = i * h
        middle = angle + 0.5 * h * _curvature(torque, table, step)
        half = torque + 0.5 * h * weight * t * np.sin(angle)
        angle += h * _curvature(half, table, step)
        torque += h * weight * (t + 0.5 * h) * np.sin(middle)
        x += h * np.sin(middle)
        y += h * np.cos(middle)
        if (i + 1) % _STEPS == 0:
            shape[(i + 1) // _STEPS, 0] = x
            shape[(i + 1) // _STEPS, 1] = y
        if angle > np.pi:
            return angle
    return angle
