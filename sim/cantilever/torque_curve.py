"""Non-parametric torque curve from deflection curves (after Miguel et al.).

Torque is a monotone cubic spline of the curvature with a few knots. They are fitted so that
computed strips of that law match the measured ones: the equilibrium is part of the fit, and no
second derivatives of measured curves are needed.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.optimize import least_squares

from common.errors import InputError
from sim.cantilever.bezier import fit_bezier
from sim.cantilever.elastica import strip_shape, tabulated_law
from sim.cantilever.regression import NOT_A_STRIP, torque_and_curvature
from sim.cantilever.table import distance_across

KNOTS = 4
POINTS, STEPS = 41, 400  # compared points of each curve; integration steps
_MARGIN = 1.25  # last knot over the largest curvature of the Bézier curves, which a fit may exceed
_SPACING_EXPONENT = 1.7  # concentrates knots near 0: most of a strip has a small curvature
_SAMPLES = 4000  # of the law, for the strips
_SMOOTHING = 0.02
"""Weight of differences of the log slope, relative to distances in units of 1 % of the strip's
length; it determines knots beyond the curvatures of all strips."""


@dataclass(frozen=True)
class TorqueCurve:
    """Torque per width, the monotone cubic spline (PCHIP) of the curvature through its knots.

    The misfit is the root mean square distance of the measured points from the fitted strips,
    relative to the mean length. Beyond the curvature reached the curve is extrapolated.
    """

    curvature: np.ndarray  # (K + 1,) 1/m, of the knots, increasing from 0
    torque: np.ndarray  # (K + 1,) N, at the knots
    misfit: float
    reached: float  # 1/m, largest curvature on any strip


def fit_torque_curve(
    curves: Sequence[np.ndarray], *, weight: float, knots: int = KNOTS, degree: int = 0
) -> TorqueCurve:
    """The torque curve of one direction from curves (each (N, 2) m) of strips clamped level.

    Strips of several lengths widen the range of curvatures. ``knots``, 2 to 8, do not include the
    one at 0. InputError for curves that do not fit a hanging strip.
    """
    if not 2 <= knots <= 8:
        raise InputError(f"knots={knots} must lie between 2 and 8")
    fits = [fit_bezier(curve, degree=degree)[0] for curve in curves]
    measured = [fit.sample(POINTS)[0] for fit in fits]
    lengths = [fit.length for fit in fits]
    torque, curvature = np.hstack([torque_and_curvature(fit, weight=weight) for fit in fits])
    slope = float(torque @ curvature / (curvature @ curvature))
    if not slope > 0:
        raise InputError(NOT_A_STRIP)
    # Curvatures of the knots are fixed. The slope between knots is positive, as slope * exp(x).
    places = _MARGIN * curvature.max() * np.linspace(0, 1, knots + 1) ** _SPACING_EXPONENT
    samples = np.linspace(0, places[-1], _SAMPLES)

    def law(x: np.ndarray) -> np.ndarray:
        return np.concatenate([[0.0], np.cumsum(slope * np.exp(x) * np.diff(places))])

    def strips(x: np.ndarray) -> list[np.ndarray]:
        pieces = tabulated_law(samples, PchipInterpolator(places, law(x))(samples))
        try:
            return [strip_shape(pieces, weight=weight, length=length, points=POINTS, steps=STEPS)
                    for length in lengths]
        except InputError:
            raise InputError("no torque curve makes a strip hang like these from a level clamp; "
                             "check their axes and the clamp") from None

    def residuals(x: np.ndarray) -> np.ndarray:
        gaps = [(strip - points).ravel() / (0.01 * length)
                for strip, points, length in zip(strips(x), measured, lengths, strict=True)]
        return np.concatenate([*gaps, _SMOOTHING * np.diff(x)])

    found = least_squares(residuals, np.zeros(knots), bounds=(-4.0, 3.0), diff_step=1e-4,
                          xtol=1e-6, ftol=1e-8, max_nfev=40)
    # Distances of the measured points: the Bézier curves used for the fit are free of noise.
    distances = np.concatenate([distance_across(curve, strip)
                                for curve, strip in zip(curves, strips(found.x), strict=True)])
    misfit = np.sqrt((distances**2).mean()) / np.mean(lengths)
    return TorqueCurve(places, law(found.x), float(misfit), float(curvature.max()))
