"""Moduli by regression of torque on curvature along a deflection curve (section 4.3.1).

The torque per width at a point of the strip is the moment of the weight beyond it,

    tau_i = rho g ∫ (x(s) - x_i) ds  from s_i to the free end                 (Eq. 5),

by the trapezoidal rule (Eq. 6). Beyond the softening limit a simulated strip does not follow the
parabola alpha kappa + beta kappa²; the fitted law is therefore :func:`sim.material.torque`, which
is the parabola up to the limit and linear beyond.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.integrate import cumulative_trapezoid
from scipy.optimize import minimize_scalar

from common.errors import InputError
from sim.cantilever.bezier import Bezier, arc_lengths, fit_bezier
from sim.material import torque

SAMPLES = 256  # points along each curve (section 4.3)
RATIO_RANGE = (-0.02, 0.02)  # m, of beta/alpha in fabrics
MAX_MISFIT = 0.5
"""Of the torque, relative. An error of 0.3 mm in the points gives 0.15; on nearly straight strips
it gives 0.4 to 0.9, with errors of alpha up to a factor of four; other curves give 0.98."""

NOT_A_STRIP = "the curves are not those of a hanging strip; check their axes and slope"


@dataclass(frozen=True)
class Estimate:
    """Moduli of one direction.

    The misfit is the root mean square residual: of the torque, relative to that of the torque
    (regression), or of the points' distances, relative to the mean length (table).
    """

    alpha: float  # N·m
    beta: float  # N·m²
    misfit: float
    curvature: float  # 1/m, largest on the curves

    @property
    def bounded(self) -> bool:
        """Whether beta/alpha is at a search bound, so that the curves do not determine beta."""
        return abs(self.beta / self.alpha) > 0.999 * RATIO_RANGE[1]


def torque_and_curvature(bezier: Bezier, *, weight: float) -> tuple[np.ndarray, np.ndarray]:
    """Torque (SAMPLES,), N, and curvature (SAMPLES,), 1/m, from the clamp to the free end."""
    points, curvature = bezier.sample(SAMPLES)
    return weight * moment_beyond(points), curvature


def moment_beyond(points: np.ndarray) -> np.ndarray:
    """(N,) integral, m², of x(s) - x_i over the curve points (N, 2), m, beyond each i (Eq. 6)."""
    x, s = points[:, 0], arc_lengths(points)
    passed = cumulative_trapezoid(x, s, initial=0)
    return passed[-1] - passed - x * (s[-1] - s)


def fit_law(curvature: np.ndarray, moment: np.ndarray) -> tuple[float, float, float]:
    """alpha, beta and relative misfit of the torque law through curvatures, 1/m, and torques,
    N·m per metre of width or any unit of theirs, (N,) each.

    For a given beta/alpha the law is proportional to alpha, so that only this ratio is searched.
    InputError if the torque does not grow with the curvature.
    """
    def project(ratio: float) -> tuple[float, float]:
        law = np.sign(curvature) * torque(np.abs(curvature), 1.0, ratio)
        alpha = float(law @ moment / (law @ law))
        return alpha, float(np.sqrt(((moment - alpha * law) ** 2).mean()))

    ratios = np.linspace(*RATIO_RANGE, 81)
    best = int(np.argmin([project(ratio)[1] for ratio in ratios]))
    found = minimize_scalar(lambda ratio: project(ratio)[1], method="bounded",
                            bounds=(ratios[max(best - 1, 0)], ratios[min(best + 1, 80)]),
                            options={"xatol": 1e-9})
    alpha, error = project(found.x)
    if not alpha > 0:
        raise InputError(NOT_A_STRIP)
    return alpha, float(alpha * found.x), error / float(np.sqrt((moment**2).mean()))


def regress(
    curves: Sequence[np.ndarray], *, weight: float, slope: float = 0.0, degree: int = 0
) -> Estimate:
    """Moduli from the curves (each (N, 2) m) of one or several strips of one direction.

    Strips of several lengths widen the range of curvatures; all samples have equal weight.
    InputError if no torque law fits the curves.
    """
    fits = [fit_bezier(curve, degree=degree, slope=slope)[0] for curve in curves]
    moment, curvature = np.hstack([torque_and_curvature(fit, weight=weight) for fit in fits])
    alpha, beta, misfit = fit_law(curvature, moment)
    if misfit > MAX_MISFIT:
        raise InputError(f"{NOT_A_STRIP}; or use method=table, which tolerates more noise "
                         f"(the law leaves {100 * misfit:.0f} % of the torque unexplained)")
    return Estimate(alpha, beta, misfit, float(curvature.max()))
