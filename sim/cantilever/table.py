"""Moduli by comparison with a table of computed deflection curves (section 4.3.2).

The nearest candidate (alpha, beta/alpha) of the table is refined by least squares of the measured
points' distances from elastica curves. This combines strips of several lengths and, unlike the
regression, needs no derivatives of a noisy curve.
"""

from collections.abc import Sequence
from itertools import product

import numpy as np
from scipy.optimize import least_squares

from common.errors import InputError
from sim.cantilever.bezier import fit_bezier
from sim.cantilever.elastica import MAX_GAMMA, heavy_elastica
from sim.cantilever.regression import NOT_A_STRIP, RATIO_RANGE, Estimate

POINTS = 41  # equidistant along each curve
GAMMAS = (0.05, 2000.0)  # range of the candidates' rho g L³/alpha
CANDIDATES = 20  # of alpha
BANDS = ((-18.0, -13.0, -8.0), (-6.0, -4.0, -2.0), (-0.5, 3.0, 8.0))
"""Candidates of beta/alpha, mm. The nearest of each band is an initial guess of a refinement,
because a stiff fabric that softens has nearly the deflection of a softer linear one."""

MAX_MISFIT = 0.1  # relative to the mean length
_CANDIDATE_STEPS, _REFINED_STEPS = 40, 400


def match(
    curves: Sequence[np.ndarray], *, weight: float, slope: float = 0.0, degree: int = 0
) -> Estimate:
    """Moduli whose elastica curves are nearest to the curves (each (N, 2) m) of one direction.

    Candidates are compared with Bézier curves through the measured points; the refinement uses the
    measured points, with the strips' lengths as further unknowns. InputError if no elastica fits.
    """
    fits = [fit_bezier(curve, degree=degree, slope=slope)[0] for curve in curves]
    lengths = np.array([fit.length for fit in fits])
    shapes, curvatures = zip(*[fit.sample(POINTS) for fit in fits], strict=True)

    def strips(unknowns: np.ndarray, points: int, steps: int) -> list[np.ndarray]:
        # beta/alpha and lengths in mm: all unknowns have similar magnitudes
        alpha, each = np.exp(unknowns[0]), 1e-3 * unknowns[2:]
        return [heavy_elastica(alpha, 1e-3 * unknowns[1] * alpha, weight=weight, length=length,
                               slope=slope, points=points, steps=steps) for length in each]

    def mean_gap(candidate: tuple[float, float]) -> float:
        models = strips(np.array([*candidate, *1e3 * lengths]), POINTS, _CANDIDATE_STEPS)
        gaps = [((model - shape) / length) ** 2
                for model, shape, length in zip(models, shapes, lengths, strict=True)]
        return float(np.mean(gaps))

    def distances(unknowns: np.ndarray) -> np.ndarray:
        models = strips(unknowns, 2 * POINTS - 1, _REFINED_STEPS)
        parts = [np.append(distance_across(curve[1:-1], model), curve[-1] - model[-1])
                 for curve, model in zip(curves, models, strict=True)]
        return np.concatenate(parts) / lengths.mean()

    log_alpha = np.linspace(np.log(weight * lengths.max() ** 3 / GAMMAS[1]),
                            np.log(weight * lengths.min() ** 3 / GAMMAS[0]), CANDIDATES)
    stiffest = np.log(weight * (1.5 * lengths.max()) ** 3 / MAX_GAMMA)
    bounds = (np.array([stiffest, 1e3 * RATIO_RANGE[0], *0.7e3 * lengths]),
              np.array([np.inf, 1e3 * RATIO_RANGE[1], *1.4e3 * lengths]))
    scale = np.array([0.1, 1.0, *np.full(len(curves), 0.1)])
    found = min(
        (least_squares(distances, [*min(product(log_alpha, band), key=mean_gap), *1e3 * lengths],
                       bounds=bounds, diff_step=1e-4, x_scale=scale) for band in BANDS),
        key=lambda result: result.cost,
    )
    misfit = float(np.sqrt((found.fun**2).mean()))
    if misfit > MAX_MISFIT:
        raise InputError(NOT_A_STRIP)
    alpha = float(np.exp(found.x[0]))
    return Estimate(alpha, float(1e-3 * found.x[1] * alpha), misfit, float(np.max(curvatures)))


def distance_across(points: np.ndarray, model: np.ndarray) -> np.ndarray:
    """Signed distances (N,) of points (N, 2) from the polygon ``model`` (M, 2), m."""
    side = np.diff(model, axis=0)
    offset = points[:, None] - model[:-1]
    along = np.clip((offset * side).sum(-1) / (side**2).sum(-1), 0.0, 1.0)
    distance = np.linalg.norm(offset - along[..., None] * side, axis=-1)
    cross = side[:, 0] * offset[..., 1] - side[:, 1] * offset[..., 0]
    nearest = np.argmin(distance, axis=1)[:, None]
    return np.take_along_axis(np.copysign(distance, cross), nearest, axis=1)[:, 0]
