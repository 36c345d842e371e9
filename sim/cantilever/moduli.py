"""Moduli and torque curves from deflection curves of strips.

Smoothing of deflection curves by Bézier curves (Feng et al. 2022, section 4.3).

Moduli by regression of torque on curvature along a deflection curve (section 4.3.1).

The torque per width at a point of the strip is the moment of the weight beyond it,

    tau_i = rho g ∫ (x(s) - x_i) ds  from s_i to the free end                 (Eq. 5),

by the trapezoidal rule (Eq. 6). Beyond the softening limit a simulated strip does not follow the
parabola alpha kappa + beta kappa²; the fitted law is therefore :func:`sim.material.torque`, which
is the parabola up to the limit and linear beyond.

Moduli by comparison with a table of computed deflection curves (section 4.3.2).

The nearest candidate (alpha, beta/alpha) of the table is refined by least squares of the measured
points' distances from elastica curves. This combines strips of several lengths and, unlike the
regression, needs no derivatives of a noisy curve.

Non-parametric torque curve from deflection curves (after Miguel et al.).

Torque is a monotone cubic spline of the curvature with a few knots. They are fitted so that
computed strips of that law match the measured ones: the equilibrium is part of the fit, and no
second derivatives of measured curves are needed.

Moduli of a fabric in warp, bias and weft from its strips.

The bias modulus of the law is that of a cylinder bent along 45°, but a free strip cut along the
bias also twists and curves across while it bends, and thus hangs slightly lower than a cylinder
(docs/validation.md). :func:`correct` removes this bias: it simulates the three strips and adjusts
the moduli until the estimates from the simulated strips equal those from the measured ones.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np
from scipy.integrate import cumulative_trapezoid
from scipy.interpolate import PchipInterpolator
from scipy.optimize import least_squares, minimize_scalar
from scipy.special import comb

from common.errors import InputError
from sim.cantilever.elastica import MAX_GAMMA, heavy_elastica, strip_shape, tabulated_law
from sim.cantilever.tester import simulate_strips
from sim.material import DIRECTIONS, Fabric, is_admissible, torque
from sim.rig import GRAVITY

DEGREES = range(3, 15)
"""Candidate degrees of a Bézier curve. A cubic curve (section 4.3) cannot follow the curvature from
clamp to free end: its error of alpha is at least 6 % (docs/validation.md)."""

_PROJECTIONS = 30  # updates of the points' parameters


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
    def length(self) -> float:
        """Arc length, m."""
        return float(self._lengths[1][-1])

    def sample(self, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Points (count, 2), m, equidistant in arc length, ends included, and their curvatures
        (count,), 1/m, positive where the strip bends down."""
        t, s = self._lengths
        t = np.interp(np.linspace(0.0, s[-1], count), s, t)
        (x, y), (xx, yy) = self.at(t, 1).T, self.at(t, 2).T
        return self.at(t), (x * yy - y * xx) / np.hypot(x, y) ** 3


def bernstein(t: np.ndarray, degree: int) -> np.ndarray:
    """(N, degree + 1) Bernstein polynomials at t (N,)."""
    k, t = np.arange(degree + 1), t[:, None]
    return comb(degree, k) * t**k * (1.0 - t) ** (degree - k)


def arc_lengths(points: np.ndarray) -> np.ndarray:
    """Arc lengths (N,), m, along the polygon of points (N, 2) from the first one."""
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    return np.concatenate([[0.0], np.cumsum(steps)])


def fit_bezier(curve: np.ndarray, *, degree: int = 0, slope: float = 0.0) -> tuple[Bezier, float]:
    """Least-squares Bézier curve of points (N, 2), m, starting at 0 in the clamp's direction.

    Each point's parameter is moved to the nearest point of the fitted curve, and the fit is
    repeated. ``degree`` 0 selects the degree in :data:`DEGREES` with the smallest Bayesian
    information criterion, so that noise is not fitted. InputError for a degree below 2, or too few
    points for the degree.

    Returns:
        The curve and the root mean square distance of the points from it, m.
    """
    count = len(curve)
    degrees = [degree] if degree else [d for d in DEGREES if 2 * (d + 1) <= count] or DEGREES[:1]
    if degrees[0] < 2:
        raise InputError(f"a Bézier curve of degree {degree} cannot bend; give 2 or more")
    if count < (needed := 2 * (degrees[0] + 1)):
        raise InputError(f"a Bézier curve of degree {degrees[0]} needs {needed} points, "
                         f"not {count}")
    # Distances below 1e-6 of the curve's size are not distinguished. Each point contributes one
    # residual, its distance across the curve.
    least = (1e-6 * np.linalg.norm(curve[-1])) ** 2
    return min((_fit_degree(curve, each, slope) for each in degrees), key=lambda fit: (
        count * np.log(fit[1] ** 2 + least) + 2 * len(fit[0].control) * np.log(count)))


def _fit_degree(curve: np.ndarray, degree: int, slope: float) -> tuple[Bezier, float]:
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


def _solve(curve: np.ndarray, t: np.ndarray, degree: int, slope: float) -> Bezier:
    """Linear least squares for fixed parameters t (N,). The first control point is 0; unknowns are
    the distance of the second along the clamp's direction and the other control points."""
    basis = bernstein(t, degree)
    along = np.array([np.cos(slope), np.sin(slope)])
    matrix = np.hstack([np.kron(basis[:, 1:2], along[:, None]), np.kron(basis[:, 2:], np.eye(2))])
    second, *others = np.linalg.lstsq(matrix, curve.ravel(), rcond=None)[0]
    return Bezier(np.vstack([[0.0, 0.0], second * along, np.reshape(others, (-1, 2))]))


SAMPLES = 256  # points along each curve (section 4.3)
RATIO_RANGE = (-0.02, 0.02)  # m, of beta/alpha in fabrics
MAX_TORQUE_MISFIT = 0.5
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
    if misfit > MAX_TORQUE_MISFIT:
        raise InputError(f"{NOT_A_STRIP}; or use method=table, which tolerates more noise "
                         f"(the law leaves {100 * misfit:.0f} % of the torque unexplained)")
    return Estimate(alpha, beta, misfit, float(curvature.max()))


POINTS = 41  # equidistant along each curve
GAMMAS = (0.05, 2000.0)  # range of the candidates' rho g L³/alpha
CANDIDATES = 20  # of alpha
BANDS = ((-18.0, -13.0, -8.0), (-6.0, -4.0, -2.0), (-0.5, 3.0, 8.0))
"""Candidates of beta/alpha, mm. The nearest of each band is an initial guess of a refinement,
because a stiff fabric that softens has nearly the deflection of a softer linear one."""

MAX_DISTANCE = 0.1  # relative to the mean length
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
    if misfit > MAX_DISTANCE:
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


METHODS = {"regression": regress, "table": match}
MAX_ROUNDS = 6
MAX_MOVE = 3.0  # of the correction in one round: 30 % in alpha, 3 mm in beta/alpha
TOLERANCE = 0.05  # 0.5 % in alpha and 0.05 mm in beta/alpha
Strips = Mapping[str, Sequence[np.ndarray]]
"""Curves (N, 2), m, of one or several strips of each direction."""


def estimate_moduli(
    strips: Strips, *, density: float, method: str = "table", slope: float = 0.0, degree: int = 0
) -> dict[str, Estimate]:
    """Moduli of each direction from its strips alone; ``density`` in kg/m², ``method`` one of
    :data:`METHODS`. InputError for curves that do not fit a hanging strip."""
    if method not in METHODS:
        raise InputError(f"unknown method '{method}'; choose from {', '.join(METHODS)}")
    found = {}
    for direction, curves in strips.items():
        try:
            found[direction] = METHODS[method](curves, weight=density * GRAVITY, slope=slope,
                                               degree=degree)
        except InputError as error:
            raise InputError(f"{direction}: {error}") from None
    return found


def fabric_of(estimates: Mapping[str, Estimate], density: float) -> Fabric:
    """The fabric with the estimated moduli of the three directions and a density, kg/m².

    InputError if a direction is missing, or if no elastic plate has these moduli.
    """
    missing = [direction for direction in DIRECTIONS if direction not in estimates]
    if missing:
        raise InputError(f"a fabric needs strips of all three directions; {missing[0]} is missing")
    return Fabric(*_moduli(_unknowns(estimates)), density=density)


def correct(
    strips: Strips, estimates: Mapping[str, Estimate], *, density: float, rounds: int = MAX_ROUNDS,
    width: float = 0.03, method: str = "table", slope: float = 0.0, degree: int = 0,
) -> Fabric:
    """Moduli whose simulated strips give the same estimates as the measured strips.

    Each round simulates the strips and estimates moduli from them by the same method. The residual
    moves the moduli by Broyden's method, as each direction's strip depends on the other moduli too.
    The regression's estimate of a bias strip's beta varies with the triangulation by a quarter.

    Args:
        strips, estimates: of all three directions, see :func:`estimate_moduli`.
        rounds: maximum number of simulation rounds.
        width: of the strips, m.

    Returns:
        The fabric with the smallest residual; InputError as for :func:`fabric_of`, or if a strip
        does not reach equilibrium.
    """
    fabric = fabric_of(estimates, density)
    lengths = {
        direction: [fit_bezier(c, degree=degree, slope=slope)[0].length for c in strips[direction]]
        for direction in DIRECTIONS
    }
    target = at = _unknowns(estimates)
    response = np.eye(len(target))
    best, least, last = fabric, np.inf, None
    for _ in range(rounds):
        simulated = simulate_strips(fabric, lengths, width=width, slope=slope)
        read = estimate_moduli(simulated, density=density, method=method, slope=slope,
                               degree=degree)
        residual = target - _unknowns(read)
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


def _unknowns(estimates: Mapping[str, Estimate]) -> np.ndarray:
    """(6,) ten times log alpha, and beta/alpha in mm: both vary by similar amounts."""
    each = [estimates[direction] for direction in DIRECTIONS]
    return np.array([10 * np.log(e.alpha) for e in each] + [1e3 * e.beta / e.alpha for e in each])


def _moduli(unknowns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """alpha (3,) and beta (3,), inverse of :func:`_unknowns`."""
    alpha = np.exp(unknowns[:3] / 10)
    return alpha, 1e-3 * unknowns[3:] * alpha
