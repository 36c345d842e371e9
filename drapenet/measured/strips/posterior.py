"""Evidence of one direction's moduli from measured strips with known errors.

Elastica curves are fitted to the curves of all strips together. Unknown are log alpha, beta/alpha
and the natural curvature, for each specimen the difference of its log alpha from the fabric's, and
for each photographed strip its length and the slope of its clamp. Errors of the curves, correlated
as a scale's are, enter by their covariance. At the best fit everything is normal (Laplace's
approximation), but the scatter of specimens, which the repeats of the direction show, over a grid.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.optimize import least_squares
from scipy.special import softmax

from common.errors import InputError
from common.normal import Linear, Normal
from common.types import DeflectionCurve, Metres, Radians
from data.readings.quantity import SPECIMEN_SCATTER
from sim.cantilever.elastica import MAX_GAMMA, aspect_ratio, gamma_of_aspect_ratio, heavy_elastica
from sim.cantilever.moduli import NOT_A_STRIP, RATIO_RANGE, distance_across

INCLINE = np.radians(41.5)
"""Of the plane that the tip of a strip of two bending lengths reaches (Peirce; ISO 9073-7)."""
SLOPE_ERROR = np.radians(0.5)  # of a clamp
MAX_MISFIT = 4.0  # largest error of a fit, in standard deviations, root mean square
MAX_SCATTER = 0.45  # of log alpha, root mean square over the specimens of a direction
SCATTERS = SPECIMEN_SCATTER * np.exp(np.linspace(-1.4, 1.4, 9))
SCATTER_SPREAD = 0.3
"""Standard deviation of the logarithm of a fabric's scatter of specimens about that of
:data:`~data.readings.quantity.SPECIMEN_SCATTER`. Assumed."""
_POINTS, _STEPS = 81, 240  # of elastica curves
_BEYOND = 0.2  # of the length, by which a model is extended
_STEP = 1e-3  # of an unknown, in differences
_UNITS = np.array([1.0, 1e-3, 10.0])  # of what all strips share; unknowns have like magnitudes
_SHARED = len(_UNITS)
_LIMITS = (0.5, 1.5)  # of a strip's length, relative


@dataclass(frozen=True)
class MeasuredStrip:
    """A strip's curve, and its free length as it is known besides."""

    curve: DeflectionCurve  # (N, 2) from the clamp's edge, 0, to the tip
    covariance: np.ndarray  # (2 N, 2 N) m², of its errors, x and y of one point after the other
    length: Metres
    length_error: Metres  # standard deviation, infinite if the length is not known
    sign: int = 1  # 1 if the marked face is up, else -1
    specimen: str = ""  # its name; '' if nothing else was measured of it


@dataclass(frozen=True)
class BendingLength:
    """A bending length, half the length of the strip whose tip reaches the plane at 41.5°."""

    length: Metres
    error: Metres
    sign: int = 1
    specimen: str = ""


@dataclass(frozen=True)
class StripEvidence:
    """What the strips of one direction say of log alpha (alpha in N·m), beta/alpha, m, and the
    natural curvature, 1/m, positive if cloth with the marked face up bends down by itself.

    Where the ``misfit`` is larger than 1, the errors of the measurements are larger by it.
    """

    measured: Linear  # without any prior
    posterior: Normal  # with the prior that was given
    misfit: float  # root mean square of the residuals, in standard deviations
    scatter: float  # standard deviation of log alpha between specimens

    @property
    def alpha(self) -> float:
        """Linear modulus, N·m, at the mean."""
        return float(np.exp(self.posterior.mean[0]))

    @property
    def beta(self) -> float:
        """Quadratic modulus, N·m², at the mean."""
        return float(self.alpha * self.posterior.mean[1])

    @property
    def curl(self) -> tuple[float, float]:
        """Mean and standard deviation of the natural curvature, 1/m."""
        return float(self.posterior.mean[2]), float(np.sqrt(self.posterior.covariance[2, 2]))

    def moved_to(self, alpha: float, beta: float) -> "StripEvidence":
        """The same with other moduli, N·m and N·m², at the mean."""
        mean = np.array([np.log(alpha), beta / alpha, self.posterior.mean[2]])
        return replace(self, measured=self.measured.moved(mean - self.posterior.mean),
                       posterior=Normal(mean, self.posterior.covariance))

    def samples(self) -> tuple[np.ndarray, np.ndarray]:
        """Samples of alpha, N·m, and beta, N·m², (4000,) each, by a fixed seed."""
        log_alpha, ratio, _ = self.posterior.samples(4000).T
        return np.exp(log_alpha), np.exp(log_alpha) * ratio

    def intervals(self, level: float) -> np.ndarray:
        """Central intervals (2, 2) of alpha, N·m, and beta, N·m², of the probability ``level``."""
        ends = [(1 - level) / 2, (1 + level) / 2]
        return np.stack([np.quantile(values, ends) for values in self.samples()])


def direction_evidence(
    strips: Sequence[MeasuredStrip], lengths: Sequence[BendingLength] = (), *, weight: float,
    prior: Normal, slope: Radians = 0.0
) -> StripEvidence:
    """Evidence from the strips and bending lengths of one direction.

    InputError if no elastica is near the curves, or if the specimens differ more than those of one
    fabric do.

    Args:
        weight: rho g, N/m².
        prior: of log alpha, beta/alpha and natural curvature, where what is measured is silent.
    """
    first = np.log([*(_linear_modulus(strip, weight) for strip in strips),
                    *(weight * each.length**3 for each in lengths)]).mean()
    fit = _Fit(strips, lengths, weight, slope, prior)
    longest = max([strip.length for strip in strips] + [2 * each.length for each in lengths])
    stiffest = np.log(weight * (_LIMITS[1] * longest) ** 3 / MAX_GAMMA)
    ratios, scatters, count = 1e3 * np.array(RATIO_RANGE), fit.specimens, len(strips)
    bounds = np.array([[stiffest, np.inf], ratios, [-5.0, 5.0]] + [[-np.inf, np.inf]] * scatters
                      + [_LIMITS] * count + [[-8.0, 8.0]] * count).T
    guess = np.concatenate([[first, *prior.mean[1:] / _UNITS[1:]], np.zeros(scatters),
                            np.ones(count), np.zeros(count)])
    result = least_squares(fit.residuals, guess.clip(*bounds), jac=fit.jacobian, bounds=bounds,
                           x_scale="jac", xtol=1e-6, ftol=1e-6, max_nfev=60)
    degrees = max(len(result.fun) - len(guess), 1)
    misfit = float(np.sqrt(np.square(result.fun).sum() / degrees))
    apart = SPECIMEN_SCATTER * np.sqrt(np.square(result.x[fit.scatter]).mean())
    if apart > MAX_SCATTER:
        raise InputError(f"the strips differ by {np.expm1(apart):.0%} in alpha, those of one "
                         f"fabric by about {SPECIMEN_SCATTER:.0%}: check that they are of one "
                         "direction, their lengths, and the density")
    if misfit > MAX_MISFIT:
        raise InputError(f"{NOT_A_STRIP}; the nearest one is {misfit:.1f} standard deviations from "
                         "them: check that the strips are of one direction, their lengths, and the "
                         "density; if these are right, the fabric is outside of the law, whose "
                         "torque is alpha times curvature and beta times its square")
    measured, scatter = fit.measured(result.x, max(misfit, 1.0))
    return StripEvidence(measured, prior.updated(measured), misfit, scatter)


def expected_evidence(
    strips: Sequence[MeasuredStrip], *, weight: float, state: np.ndarray
) -> Linear:
    """Evidence of log alpha, beta/alpha and natural curvature that strips of one direction would
    give whose curves are exactly those of this ``state`` (3,); ``weight``: rho g, N/m²."""
    fit = _Fit(strips, (), weight, 0.0, Normal(state, np.eye(_SHARED)))
    count = len(strips)
    return fit.measured(np.concatenate([
        state / _UNITS, np.zeros(fit.specimens), np.ones(count), np.zeros(count)]), 1.0)[0]


class _Fit:
    """Residuals, in standard deviations, of the unknowns log alpha, beta/alpha in mm, natural
    curvature in :data:`_UNITS`, differences of the specimens' log alpha in
    :data:`~data.readings.quantity.SPECIMEN_SCATTER`, relative lengths of the strips, and slopes of
    their clamps in :data:`SLOPE_ERROR`."""

    def __init__(self, strips: Sequence[MeasuredStrip], lengths: Sequence[BendingLength],
                 weight: float, slope: Radians, prior: Normal) -> None:
        self.strips, self.lengths, self.weight, self.slope = strips, lengths, weight, slope
        self.white = [_whitening(strip) for strip in strips]
        self.prior = prior
        self.root = np.linalg.inv(np.linalg.cholesky(prior.covariance)) * _UNITS
        stated = [*(each.specimen for each in strips), *(each.specimen for each in lengths)]
        names = [specimen or f"entry {k}" for k, specimen in enumerate(stated)]
        self.specimen = [_SHARED + list(dict.fromkeys(names)).index(name) for name in names]
        self.specimens = len(set(names))
        self.scatter = slice(_SHARED, _SHARED + self.specimens)

    def residuals(self, unknowns: np.ndarray) -> np.ndarray:
        """(R,) of the prior and the specimens, then of each strip and each bending length."""
        shared = unknowns[:_SHARED]
        return np.concatenate([
            self.root @ (shared - self.prior.mean / _UNITS), unknowns[self.scatter],
            *(part(unknowns[columns]) for part, columns in self._parts())])

    def jacobian(self, unknowns: np.ndarray) -> np.ndarray:
        """(R, U) derivatives by differences; a strip depends on its own specimen, length and slope
        alone."""
        rows = [np.eye(len(unknowns))[: self.scatter.stop]]
        rows[0][:_SHARED, :_SHARED] = self.root
        for part, columns in self._parts():
            at = unknowns[columns]
            block = np.stack([(part(at + step) - part(at - step)) / (2 * _STEP)
                              for step in _STEP * np.eye(len(at))], axis=1)
            rows.append(np.zeros((len(block), len(unknowns))))
            rows[-1][:, columns] = block
        return np.vstack(rows)

    def measured(self, unknowns: np.ndarray, misfit: float) -> tuple[Linear, float]:
        """Evidence of log alpha, beta/alpha in m and curvature in 1/m, without the prior, and the
        specimens' scatter; errors of measurements are larger by ``misfit``."""
        rows, residuals = self.jacobian(unknowns), self.residuals(unknowns)
        rows[self.scatter.stop :] /= misfit
        residuals[self.scatter.stop :] /= misfit
        values = rows @ unknowns - residuals
        logs = [self._log_evidence(rows, values, scatter) for scatter in SCATTERS]
        scatter = float(np.sqrt(softmax(logs) @ np.square(SCATTERS)))
        scale = self._scale(len(rows), scatter)[_SHARED:]
        # The unknowns of single strips first, and eliminated.
        ordered = np.roll(rows[_SHARED:], -_SHARED, axis=1)
        q, r = np.linalg.qr(scale[:, None] * ordered)
        own = len(unknowns) - _SHARED
        return Linear(r[own:, own:] / _UNITS,
                      (q.T @ (scale * values[_SHARED:]))[own:]), scatter

    def _log_evidence(self, rows: np.ndarray, values: np.ndarray, scatter: float) -> float:
        """Logarithm, but for a constant, of the probability density of ``scatter`` given all."""
        scale, ratio = self._scale(len(rows), scatter), SPECIMEN_SCATTER / scatter
        q, r = np.linalg.qr(scale[:, None] * rows)
        cost = np.square(scale * values).sum() - np.square(q.T @ (scale * values)).sum()
        return (-0.5 * cost - np.log(np.abs(np.diag(r))).sum() + self.specimens * np.log(ratio)
                - 0.5 * (np.log(ratio) / SCATTER_SPREAD) ** 2)

    def _scale(self, rows: int, scatter: float) -> np.ndarray:
        """(rows,) factors of the residuals if specimens have this scatter."""
        scale = np.ones(rows)
        scale[self.scatter] = SPECIMEN_SCATTER / scatter
        return scale

    def _parts(self) -> Iterator[tuple[Callable[[np.ndarray], np.ndarray], np.ndarray]]:
        """Residuals of each strip and bending length, and the unknowns on which they depend."""
        for k in range(len(self.strips)):
            length = self.scatter.stop + k
            yield partial(self._strip, k), np.array(
                [*range(_SHARED), self.specimen[k], length, length + len(self.strips)])
        for each, place in zip(self.lengths, self.specimen[len(self.strips):], strict=True):
            yield partial(self._length, each), np.array([*range(_SHARED), place])

    def _shape(
        self, shared: Sequence[float] | np.ndarray, sign: int, length: Metres, slope: Radians
    ) -> DeflectionCurve:
        """Of log alpha, beta/alpha, curvature and difference of the specimen."""
        alpha = np.exp(shared[0] + SPECIMEN_SCATTER * shared[3])
        return heavy_elastica(alpha, 1e-3 * shared[1] * alpha, weight=self.weight, length=length,
                              curl=sign * _UNITS[2] * shared[2], slope=slope, points=_POINTS,
                              steps=_STEPS)

    def _strip(self, k: int, unknowns: np.ndarray) -> np.ndarray:
        strip, (*shared, stretch, tilt) = self.strips[k], unknowns
        length = stretch * strip.length
        model = self._shape(shared, strip.sign, length, self.slope + SLOPE_ERROR * tilt)
        end, last = strip.curve[-1] - model[-1], _directions(model)[-1]
        # The measured tip may lie beyond the model's, whose curvature is 0 there.
        straight = model[-1] + _BEYOND * length * last
        across = distance_across(strip.curve[1:-1], np.vstack([model, straight]))
        offsets = np.concatenate([across, [end @ [-last[1], last[0]], end @ last]])
        return np.concatenate([self.white[k] @ offsets,
                               [tilt, (length - strip.length) / strip.length_error]])

    def _length(self, each: BendingLength, shared: np.ndarray) -> np.ndarray:
        ends = [self._shape(shared, each.sign, 2 * stretch * each.length, 0.0)[-1]
                for stretch in (1.0, 1.01)]
        angle, longer = (np.arctan2(y, x) for x, y in ends)
        growth = (longer - angle) / 0.01  # rad, for a relative change of the length
        return np.array([(angle - INCLINE) / (growth * each.error / each.length)])


def _linear_modulus(strip: MeasuredStrip, weight: float) -> float:
    """The modulus, N·m, of linear cloth with the drop and reach of a strip."""
    return weight * strip.length**3 / gamma_of_aspect_ratio(aspect_ratio(strip.curve[-1]))


def _directions(curve: DeflectionCurve) -> np.ndarray:
    """Unit tangents (N, 2) of a curve."""
    along = np.gradient(curve, axis=0)
    return along / np.linalg.norm(along, axis=1)[:, None]


def _whitening(strip: MeasuredStrip) -> np.ndarray:
    """(N, N) matrix that gives independent residuals of unit variance from the offsets across the
    curve, of all points but the clamp's, and along it at the tip."""
    along = _directions(strip.curve)
    count = len(along)
    project = np.zeros((count, 2 * count))
    for k in range(1, count):
        project[k - 1, 2 * k : 2 * k + 2] = -along[k, 1], along[k, 0]
    project[-1, -2:] = along[-1]
    return np.linalg.inv(np.linalg.cholesky(project @ strip.covariance @ project.T))
