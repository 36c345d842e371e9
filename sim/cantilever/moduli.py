"""Moduli from deflection curves of strips by comparison with computed curves (Feng et al. 2022,
section 4.3.2). Bézier curves smooth the measured ones.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np
from scipy.integrate import cumulative_trapezoid
from scipy.optimize import least_squares
from scipy.special import comb

from common.errors import InputError
from common.types import DeflectionCurve, Density, Metres, Moduli, QuadraticModuli, Radians
from sim.cantilever.elastica import MAX_GAMMA, heavy_elastica
from sim.cantilever.strip import simulate_strips
from sim.material import DIRECTIONS, Fabric, is_admissible
from sim.rig import GRAVITY

DEGREES = range(3, 15)
"""Candidate degrees of a Bézier curve. A cubic curve (section 4.3) cannot follow the curvature from
clamp to free end: alpha is at least 6 % too small."""
_PROJECTIONS = 30  # updates of the points' parameters

RATIO_RANGE = (-0.02, 0.02)  # m, of beta/alpha in fabrics

POINTS = 41  # equidistant along each curve that is compared with computed ones
GAMMAS = (0.05, 2000.0)  # range of rho g L³/alpha in the table
CANDIDATES = 20  # of alpha
BANDS = ((-18.0, -13.0, -8.0), (-6.0, -4.0, -2.0), (-0.5, 3.0, 8.0))
"""Candidates of beta/alpha, mm. The nearest of each band is an initial guess of a refinement,
because a stiff fabric that softens has nearly the deflection of a softer linear one."""
MAX_DISTANCE = 0.1  # root mean square, relative to the mean length
_CANDIDATE_STEPS, _STEPS = 40, 400  # of the integration

MAX_ROUNDS = 6
MAX_MOVE = 3.0  # of the correction in one round: 30 % in alpha, 3 mm in beta/alpha
TOLERANCE = 0.05  # 0.5 % in alpha and 0.05 mm in beta/alpha

NOT_A_STRIP = "the curves are not those of a hanging strip; check their axes and slope"
Strips = Mapping[str, Sequence[DeflectionCurve]]
"""Curves of one or several strips of each direction."""


@dataclass(frozen=True)
class StripModuli:
    """Moduli of one direction."""

    alpha: float  # N·m
    beta: float  # N·m²


@dataclass(frozen=True)
class Bezier:
    """A plane Bézier curve with control points (d + 1, 2), m."""

    control: np.ndarray

    def at(self, t: np.ndarray, order: int = 0) -> np.ndarray:
        """Points (N, 2), or derivatives of that ``order``, at parameters t (N,) in [0, 1]."""
        points = self.control
        for _ in range(order):
            points = (len(points) - 1) * np.diff(points, axis=0)
        return bernstein(t, len(points) - 1) @ points

    @cached_property
    def _lengths(self) -> tuple[np.ndarray, np.ndarray]:
        t = np.linspace(0.0, 1.0, 2049)
        return t, cumulative_trapezoid(np.linalg.norm(self.at(t, 1), axis=1), t, initial=0)

    @property
    def length(self) -> Metres:
        """Arc length."""
        return float(self._lengths[1][-1])

    def sample(self, count: int) -> np.ndarray:
        """Points (count, 2), m, equidistant in arc length, ends included."""
        t, s = self._lengths
        return self.at(np.interp(np.linspace(0.0, s[-1], count), s, t))


def bernstein(t: np.ndarray, degree: int) -> np.ndarray:
    """(N, degree + 1) Bernstein polynomials at t (N,)."""
    k, t = np.arange(degree + 1), t[:, None]
    return comb(degree, k) * t**k * (1.0 - t) ** (degree - k)


def arc_lengths(curve: DeflectionCurve) -> np.ndarray:
    """Arc lengths (N,), m, along the polygon of the points from the first one."""
    steps = np.linalg.norm(np.diff(curve, axis=0), axis=1)
    return np.concatenate([[0.0], np.cumsum(steps)])


def fit_bezier(curve: DeflectionCurve, *, slope: Radians = 0.0) -> Bezier:
    """Least-squares Bézier curve that starts at 0 in the clamp's direction, of the degree in
    :data:`DEGREES` with the smallest Bayesian information criterion, so that noise is not fitted.
    """
    count = len(curve)
    if count < (needed := 2 * (DEGREES[0] + 1)):
        raise InputError(f"a Bézier curve of degree {DEGREES[0]} needs {needed} points, "
                         f"not {count}")
    # Distances below 1e-6 of the curve's size are not distinguished. Each point contributes one
    # residual, its distance across the curve.
    least = (1e-6 * np.linalg.norm(curve[-1])) ** 2
    fits = (fit_degree(curve, degree, slope) for degree in DEGREES if 2 * (degree + 1) <= count)
    return min(fits, key=lambda fit: (
        count * np.log(fit[1] ** 2 + least) + 2 * len(fit[0].control) * np.log(count)))[0]


def fit_degree(curve: DeflectionCurve, degree: int, slope: Radians = 0.0) -> tuple[Bezier, Metres]:
    """The fit of one ``degree``, repeated with each point's parameter moved to the nearest point of
    the curve, and the root mean square distance of the points from it."""
    t = arc_lengths(curve)
    t /= t[-1]
    bezier = _solve(curve, t, degree, slope)
    for _ in range(_PROJECTIONS):
        offset = curve - bezier.at(t)
        first, second = bezier.at(t, 1), bezier.at(t, 2)
        speed = (first**2).sum(1)
        stiffness = np.maximum(speed - (offset * second).sum(1), 0.5 * speed)
        t = np.clip(t + (offset * first).sum(1) / stiffness, 0.0, 1.0)
        bezier = _solve(curve, t, degree, slope)
    return bezier, float(np.sqrt(((curve - bezier.at(t)) ** 2).sum(1).mean()))


def _solve(curve: DeflectionCurve, t: np.ndarray, degree: int, slope: Radians) -> Bezier:
    """Linear least squares for fixed parameters t (N,). The first control point is 0; unknowns are
    the distance of the second along the clamp's direction and the other control points."""
    basis = bernstein(t, degree)
    along = np.array([np.cos(slope), np.sin(slope)])
    matrix = np.hstack([np.kron(basis[:, 1:2], along[:, None]), np.kron(basis[:, 2:], np.eye(2))])
    second, *others = np.linalg.lstsq(matrix, curve.ravel(), rcond=None)[0]
    return Bezier(np.vstack([[0.0, 0.0], second * along, np.reshape(others, (-1, 2))]))


def match(curves: Sequence[DeflectionCurve], *, weight: float, slope: Radians = 0.0) -> StripModuli:
    """Moduli whose elastica curves are nearest to the curves of one direction.

    The candidates (alpha, beta/alpha) of a table nearest to Bézier curves through the points are
    refined by least squares of the points' distances from elastica curves, with the strips' lengths
    as further unknowns.
    """
    fits = [fit_bezier(curve, slope=slope) for curve in curves]
    lengths = np.array([fit.length for fit in fits])
    shapes = [fit.sample(POINTS) for fit in fits]

    def strips(unknowns: np.ndarray, points: int, steps: int) -> list[np.ndarray]:
        # beta/alpha and lengths in mm: all unknowns have similar magnitudes
        alpha = np.exp(unknowns[0])
        return [heavy_elastica(alpha, 1e-3 * unknowns[1] * alpha, weight=weight, length=length,
                               slope=slope, points=points, steps=steps)
                for length in 1e-3 * unknowns[2:]]

    def mean_gap(candidate: tuple[float, float]) -> float:
        models = strips(np.array([*candidate, *1e3 * lengths]), POINTS, _CANDIDATE_STEPS)
        gaps = [((model - shape) / length) ** 2
                for model, shape, length in zip(models, shapes, lengths, strict=True)]
        return float(np.mean(gaps))

    def distances(unknowns: np.ndarray) -> np.ndarray:
        models = strips(unknowns, 2 * POINTS - 1, _STEPS)
        parts = [np.append(distance_across(curve[1:-1], model), curve[-1] - model[-1])
                 for curve, model in zip(curves, models, strict=True)]
        return np.concatenate(parts) / lengths.mean()

    log_alpha = np.linspace(np.log(weight * lengths.max() ** 3 / GAMMAS[1]),
                            np.log(weight * lengths.min() ** 3 / GAMMAS[0]), CANDIDATES)
    stiffest = np.log(weight * (1.5 * lengths.max()) ** 3 / MAX_GAMMA)
    bounds = (np.array([stiffest, 1e3 * RATIO_RANGE[0], *0.7e3 * lengths]),
              np.array([np.inf, 1e3 * RATIO_RANGE[1], *1.4e3 * lengths]))
    scale = np.array([0.1, 1.0, *np.full(len(curves), 0.1)])
    best = min(
        (least_squares(distances, [*min(product(log_alpha, band), key=mean_gap), *1e3 * lengths],
                       bounds=bounds, diff_step=1e-4, x_scale=scale) for band in BANDS),
        key=lambda result: result.cost,
    )
    if np.sqrt((best.fun**2).mean()) > MAX_DISTANCE:
        raise InputError(NOT_A_STRIP)
    alpha = float(np.exp(best.x[0]))
    return StripModuli(alpha, float(1e-3 * best.x[1] * alpha))


def distance_across(curve: DeflectionCurve, model: DeflectionCurve) -> np.ndarray:
    """Signed distances (N,), m, of the points of a curve from the polygon ``model``."""
    side = np.diff(model, axis=0)
    offset = curve[:, None] - model[:-1]
    along = np.clip((offset * side).sum(-1) / (side**2).sum(-1), 0.0, 1.0)
    distance = np.linalg.norm(offset - along[..., None] * side, axis=-1)
    cross = side[:, 0] * offset[..., 1] - side[:, 1] * offset[..., 0]
    nearest = np.argmin(distance, axis=1)[:, None]
    return np.take_along_axis(np.copysign(distance, cross), nearest, axis=1)[:, 0]


def correct(
    strips: Strips, moduli: Mapping[str, StripModuli], *, density: Density,
    rounds: int = MAX_ROUNDS, width: Metres = 0.03, slope: Radians = 0.0
) -> Fabric:
    """The fabric whose simulated strips give the same ``moduli`` as the measured strips.

    A free strip cut along the bias also twists and curves across, and thus hangs slightly lower
    than a cylinder (docs/validation.md). Each round simulates the three strips and estimates moduli
    from them in the same way; the residual moves the moduli by Broyden's method.
    """
    target = at = _unknowns(moduli)
    fabric = Fabric(*_moduli(target), density=density)
    lengths = {direction: [fit_bezier(curve, slope=slope).length for curve in strips[direction]]
               for direction in DIRECTIONS}
    response = np.eye(len(target))
    best, least, last = fabric, np.inf, None
    for _ in range(rounds):
        simulated = simulate_strips(fabric, lengths, width=width, slope=slope)
        residual = target - _unknowns({
            direction: match(curves, weight=density * GRAVITY, slope=slope)
            for direction, curves in simulated.items()})
        if np.linalg.norm(residual) < least:
            best, least = fabric, float(np.linalg.norm(residual))
        if last is not None:
            step, change = at - last[0], last[1] - residual
            response += np.outer(change - response @ step, step) / (step @ step)
        last = at, residual
        if least < TOLERANCE:
            break
        move = np.linalg.lstsq(response, residual, rcond=1e-3)[0]
        move *= min(1.0, MAX_MOVE / np.abs(move).max())
        while not is_admissible(*_moduli(at + move)):
            move = move / 2
        at = at + move
        fabric = Fabric(*_moduli(at), density=density)
    return best


def _unknowns(moduli: Mapping[str, StripModuli]) -> np.ndarray:
    """(6,) ten times log alpha, and beta/alpha in mm: both vary by similar amounts."""
    alpha, beta = np.array([(moduli[d].alpha, moduli[d].beta) for d in DIRECTIONS]).T
    return np.concatenate([10 * np.log(alpha), 1e3 * beta / alpha])


def _moduli(unknowns: np.ndarray) -> tuple[Moduli, QuadraticModuli]:
    """Inverse of :func:`_unknowns`."""
    alpha = np.exp(unknowns[:3] / 10)
    return alpha, 1e-3 * unknowns[3:] * alpha
