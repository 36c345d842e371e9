"""Moduli by the nearest deflection curve in a table of computed ones (section 4.3.2).

Curves of strips of length 1 depend on gamma = rho g L³/alpha and on -beta/(alpha L) only, so one
table serves all fabrics and lengths. The nearest of a grid of candidates (alpha, beta/alpha) is
then refined by least squares of the measured points' distances from elastica curves, which joins
strips of several lengths and, unlike the regression, needs no derivatives of a noisy curve.
"""

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from scipy.interpolate import RegularGridInterpolator
from scipy.optimize import least_squares

from common.errors import InputError
from sim.cantilever.bezier import fit_bezier
from sim.cantilever.elastica import LARGEST_GAMMA, elastica, heavy_elastica
from sim.cantilever.regression import NO_STRIP, RATIO_RANGE, Estimate

POINTS = 41
"""At equal distances along each curve."""

GAMMAS = np.exp(np.linspace(np.log(0.05), np.log(2000.0), 48))
SOFTENINGS = np.linspace(-0.4, 0.8, 49)
"""The table's gamma and -beta/(alpha L); fabrics beyond are no candidates."""

CANDIDATES = (121, 81)  # of alpha, beta/alpha
BANDS = (-0.006, -0.001)
"""m; the ranges of beta/alpha that these bounds leave each give a start for the refinement, because
a stiff fabric that softens hangs much like a softer one that does not."""

INTERPOLATED = 3e-3
"""Error of a curve interpolated in the table, relative to the strip's length."""

LARGEST_MISFIT = 0.1  # relative to the mean length
_TABLE_STEPS, _REFINED_STEPS = 120, 400


@lru_cache(maxsize=8)
def curve_table(slope: float = 0.0) -> RegularGridInterpolator:
    """Interpolator from (log gamma, -beta/(alpha L)) to curves (2 * POINTS,), reach then drop."""
    curves = [
        [elastica(gamma, POINTS, softening=softening, slope=slope, steps=_TABLE_STEPS).T.ravel()
         for softening in SOFTENINGS]
        for gamma in GAMMAS
    ]
    return RegularGridInterpolator(
        (np.log(GAMMAS), SOFTENINGS), curves, bounds_error=False, fill_value=np.nan
    )


def match(
    curves: Sequence[np.ndarray], *, weight: float, slope: float = 0.0, degree: int | None = None
) -> Estimate:
    """Moduli whose elastica curves lie nearest the curves (each (N, 2) m) of one direction.

    The nearest of the table's curves is sought with Bézier curves through the measured ones; the
    refinement takes the measured points themselves, and the strips' lengths are unknowns of it.

    Args:
        weight: rho g, N/m².
        slope, degree: see :func:`sim.cantilever.bezier.fit_bezier`.

    Raises:
        InputError: no curve of the table comes near.
    """
    fits = [fit_bezier(curve, degree=degree, slope=slope)[0] for curve in curves]
    lengths = np.array([fit.length for fit in fits])
    along = [fit.evenly(POINTS) for fit in fits]
    shapes = [fit.at(t) / fit.length for fit, t in zip(fits, along, strict=True)]

    def distances(unknowns: np.ndarray) -> np.ndarray:
        alpha = np.exp(unknowns[0])
        parts = []
        for curve, length in zip(curves, 1e-3 * unknowns[2:], strict=True):
            model = heavy_elastica(
                alpha, 1e-3 * unknowns[1] * alpha, weight=weight, length=length, slope=slope,
                points=2 * POINTS - 1, steps=_REFINED_STEPS,
            )
            parts += [distance_across(curve[1:-1], model), curve[-1] - model[-1]]
        return np.concatenate(parts) / lengths.mean()

    # beta/alpha and lengths in mm, so that all unknowns are of like size
    stiffest = np.log(weight * (1.5 * lengths.max()) ** 3 / LARGEST_GAMMA)
    low = np.concatenate([[stiffest, 1e3 * RATIO_RANGE[0]], 0.7e3 * lengths])
    high = np.concatenate([[np.inf, 1e3 * RATIO_RANGE[1]], 1.4e3 * lengths])
    scale = np.concatenate([[0.1, 1.0], np.full(len(curves), 0.1)])
    refined = []
    for start in _nearest(shapes, lengths, weight, slope):
        start = np.clip(np.concatenate([start, 1e3 * lengths]), low + 1e-6, high - 1e-6)
        refined.append(
            least_squares(distances, start, bounds=(low, high), diff_step=1e-4, x_scale=scale)
        )
    found = min(refined, key=lambda result: result.cost)
    misfit = float(np.sqrt((found.fun**2).mean()))
    if misfit > LARGEST_MISFIT:
        raise InputError(NO_STRIP)
    alpha = float(np.exp(found.x[0]))
    curvature = max(float(fit.curvature(t).max()) for fit, t in zip(fits, along, strict=True))
    return Estimate(alpha, float(1e-3 * found.x[1] * alpha), misfit, curvature)


def distance_across(points: np.ndarray, model: np.ndarray) -> np.ndarray:
    """(N,) distances of points (N, 2) from the polygon model (M, 2), m, positive on one side."""
    side = np.diff(model, axis=0)
    offset = points[:, None] - model[:-1]
    along = np.clip((offset * side).sum(-1) / (side**2).sum(-1), 0.0, 1.0)
    distance = np.linalg.norm(offset - along[..., None] * side, axis=-1)
    cross = side[:, 0] * offset[..., 1] - side[:, 1] * offset[..., 0]
    nearest = np.argmin(distance, axis=1)[:, None]
    return np.take_along_axis(np.copysign(distance, cross), nearest, axis=1)[:, 0]


def _nearest(
    shapes: Sequence[np.ndarray], lengths: np.ndarray, weight: float, slope: float
) -> list[np.ndarray]:
    """(log alpha, beta/alpha in mm) of the candidates nearest ``shapes``, each (POINTS, 2).

    One for each band of beta/alpha that the table's own error does not rule out. ``lengths`` (K,)
    m; the range of alpha is what the table holds for all of the strips.
    """
    table = curve_table(slope)
    log_alpha = np.linspace(
        np.log(weight * lengths.max() ** 3 / GAMMAS[-1]) + 1e-9,
        np.log(weight * lengths.min() ** 3 / GAMMAS[0]) - 1e-9,
        CANDIDATES[0],
    )
    ratio = np.linspace(*RATIO_RANGE, CANDIDATES[1])
    grid = np.stack(np.meshgrid(log_alpha, ratio, indexing="ij"), axis=-1)
    squares = [
        ((table((np.log(weight * length**3) - grid[..., 0], -grid[..., 1] / length))
          - shape.T.ravel()) ** 2).mean(axis=-1)
        for shape, length in zip(shapes, lengths, strict=True)
    ]
    # Outside the table for one of the strips: no candidate.
    distance = np.nan_to_num(np.sqrt(np.mean(squares, axis=0)), nan=np.inf)
    nearest = []
    band = np.searchsorted(BANDS, grid[..., 1])
    for k in range(len(BANDS) + 1):
        within = np.where(band == k, distance, np.inf)
        best = np.unravel_index(np.argmin(within), within.shape)
        if within[best] < 2 * distance.min() + INTERPOLATED:
            nearest.append(grid[best] * [1.0, 1e3])
    return nearest
