"""The posterior of one direction's moduli from measured strips with known errors.

Elastica curves are fitted to the curves of all strips together. Unknown are log alpha, beta/alpha
and the natural curvature, and for each strip its length and the slope of its clamp. Errors of the
curves, correlated as a scale's are, enter by their covariance; the result is the normal
distribution at the best fit (Laplace's approximation).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.optimize import least_squares

from common.errors import InputError
from common.types import DeflectionCurve, Metres, Radians
from sim.cantilever.elastica import MAX_GAMMA, aspect_ratio, gamma_of_aspect_ratio, heavy_elastica
from sim.cantilever.moduli import NOT_A_STRIP, RATIO_RANGE, distance_across

INCLINE = np.radians(41.5)
"""Of the plane that the tip of a strip of two bending lengths reaches (Peirce; ISO 9073-7)."""
RATIO_PRIOR = (-2.6e-3, 3e-3)
"""m, mean and standard deviation of beta/alpha; those of 201 published fabrics are -2.6 and 1.3
mm. It matters for bending lengths and for short strips, which determine one modulus."""
CURL_PRIOR = 7.1
"""1/m, standard deviation of the natural curvature: that of fabrics in
``configs/nuisances/real.yaml``. Strips of one face alone do not separate it from the moduli."""
SLOPE_ERROR = np.radians(0.5)  # of a clamp
MAX_MISFIT = 4.0  # largest error of a fit, in standard deviations, root mean square
_POINTS, _STEPS = 81, 240  # of elastica curves
_BEYOND = 0.2  # of the length, by which a model is extended
_STEP = 1e-3  # of an unknown, in differences
_CURL_UNIT = 10.0  # 1/m; unknowns of a fit have similar magnitudes
_SHARED = 3  # unknowns of all strips of a direction
_LIMITS = (0.5, 1.5)  # of a strip's length, relative


@dataclass(frozen=True)
class MeasuredStrip:
    """A deflection curve (N, 2) whose first point is the clamp's edge, 0, and whose last is the
    tip.

    Attributes:
        covariance: (2 N, 2 N) m², of its errors, x and y of one point after the other.
        length: free length that is known besides the curve, with its standard deviation
            ``length_error``, m, infinite if it is not.
        sign: 1 if the marked face is up, else -1.
    """

    curve: DeflectionCurve
    covariance: np.ndarray
    length: Metres
    length_error: Metres
    sign: int = 1


@dataclass(frozen=True)
class BendingLength:
    """A bending length, half the length of the strip whose tip reaches the plane at 41.5°."""

    length: Metres
    error: Metres
    sign: int = 1


@dataclass(frozen=True)
class StripPosterior:
    """Normal distribution of one direction's log alpha (alpha in N·m), beta/alpha, m, and natural
    curvature, 1/m, positive if cloth with the marked face up bends down by itself.

    It contains the priors :data:`RATIO_PRIOR` and :data:`CURL_PRIOR`; :meth:`likelihood` does not.

    Attributes:
        mean, covariance: (3,) and (3, 3).
        misfit: root mean square of the residuals, in standard deviations; if larger than 1, the
            covariance is larger by its square.
    """

    mean: np.ndarray
    covariance: np.ndarray
    misfit: float

    @property
    def alpha(self) -> float:
        """Linear modulus, N·m, at the mean."""
        return float(np.exp(self.mean[0]))

    @property
    def beta(self) -> float:
        """Quadratic modulus, N·m², at the mean."""
        return float(self.alpha * self.mean[1])

    @property
    def curl(self) -> tuple[float, float]:
        """Mean and standard deviation of the natural curvature, 1/m."""
        return float(self.mean[2]), float(np.sqrt(self.covariance[2, 2]))

    def moved_to(self, alpha: float, beta: float) -> "StripPosterior":
        """The same with other moduli, N·m and N·m², at the mean."""
        return replace(self, mean=np.array([np.log(alpha), beta / alpha, self.mean[2]]))

    def samples(self, count: int = 4000) -> tuple[np.ndarray, np.ndarray]:
        """Samples of alpha, N·m, and beta, N·m², (count,) each, by a fixed seed."""
        white = np.random.default_rng(0).standard_normal((count, 3))
        log_alpha, ratio, _ = (self.mean + white @ np.linalg.cholesky(self.covariance).T).T
        return np.exp(log_alpha), np.exp(log_alpha) * ratio

    def intervals(self, level: float) -> np.ndarray:
        """Central intervals (2, 2) of alpha, N·m, and beta, N·m², with the probability ``level``.
        """
        ends = [(1 - level) / 2, (1 + level) / 2]
        return np.stack([np.quantile(values, ends) for values in self.samples()])

    def likelihood(self) -> tuple[np.ndarray, np.ndarray]:
        """Precision matrix P (3, 3) and vector h (3,) of the measurements alone, without the
        priors: their log likelihood is -x'P x/2 + h'x of x = (log alpha, beta/alpha, natural
        curvature). Of one strip P is nearly singular."""
        precision = np.linalg.inv(self.covariance)
        prior = np.diag([0.0, RATIO_PRIOR[1] ** -2, CURL_PRIOR**-2])
        return precision - prior, precision @ self.mean - prior @ [0.0, RATIO_PRIOR[0], 0.0]


def direction_posterior(
    strips: Sequence[MeasuredStrip], lengths: Sequence[BendingLength] = (), *, weight: float,
    slope: Radians = 0.0
) -> StripPosterior:
    """Posterior from the strips and bending lengths of one direction; ``weight`` is rho g, N/m².

    InputError if no elastica is near the curves.
    """
    first = np.log([*(_linear_modulus(strip, weight) for strip in strips),
                    *(weight * each.length**3 for each in lengths)]).mean()
    fit = _Fit(strips, lengths, weight, slope)
    longest = max([strip.length for strip in strips] + [2 * each.length for each in lengths])
    stiffest = np.log(weight * (_LIMITS[1] * longest) ** 3 / MAX_GAMMA)
    ratios, count = 1e3 * np.array(RATIO_RANGE), len(strips)
    bounds = np.array([[stiffest, np.inf], ratios, [-5.0, 5.0]] + [_LIMITS] * count
                      + [[-8.0, 8.0]] * count).T
    guess = np.array([first, 1e3 * RATIO_PRIOR[0], 0.0] + [1.0] * count + [0.0] * count)
    result = least_squares(fit.residuals, guess, jac=fit.jacobian, bounds=bounds,
                           x_scale="jac", xtol=1e-6, ftol=1e-6, max_nfev=60)
    degrees = max(len(result.fun) - len(guess), 1)
    misfit = float(np.sqrt(np.square(result.fun).sum() / degrees))
    if misfit > MAX_MISFIT:
        raise InputError(f"{NOT_A_STRIP}; the nearest one is {misfit:.1f} standard deviations from "
                         "them: check that the strips are of one direction, their lengths, and the "
                         "density")
    covariance = np.linalg.inv(result.jac.T @ result.jac) * max(misfit, 1.0) ** 2
    unit = np.array([1.0, 1e-3, _CURL_UNIT])
    return StripPosterior(result.x[:_SHARED] * unit,
                          covariance[:_SHARED, :_SHARED] * np.outer(unit, unit), misfit)


class _Fit:
    """Residuals, in standard deviations, of the unknowns log alpha, beta/alpha in mm, natural
    curvature in :data:`_CURL_UNIT`, relative lengths of the strips, and slopes of their clamps in
    :data:`SLOPE_ERROR`."""

    def __init__(self, strips: Sequence[MeasuredStrip], lengths: Sequence[BendingLength],
                 weight: float, slope: Radians) -> None:
        self.strips, self.lengths, self.weight, self.slope = strips, lengths, weight, slope
        self.white = [_whitening(strip) for strip in strips]

    def residuals(self, unknowns: np.ndarray) -> np.ndarray:
        """(R,) priors, then those of each strip and each bending length."""
        mean, error = (1e3 * value for value in RATIO_PRIOR)
        shared = unknowns[:_SHARED]
        priors = [(shared[1] - mean) / error, shared[2] * _CURL_UNIT / CURL_PRIOR]
        return np.concatenate([priors, *(self._strip(k, unknowns[self._columns(k)])
                                         for k in range(len(self.strips))),
                               *(self._length(each, shared) for each in self.lengths)])

    def jacobian(self, unknowns: np.ndarray) -> np.ndarray:
        """(R, U) derivatives by differences; a strip depends on its own length and slope alone."""
        rows = [np.eye(len(unknowns))[1:_SHARED]]
        rows[0][0] /= 1e3 * RATIO_PRIOR[1]
        rows[0][1] *= _CURL_UNIT / CURL_PRIOR
        parts = [(partial(self._strip, k), self._columns(k)) for k in range(len(self.strips))]
        parts += [(partial(self._length, each), np.arange(_SHARED)) for each in self.lengths]
        for part, columns in parts:
            at = unknowns[columns]
            block = np.stack([(part(at + step) - part(at - step)) / (2 * _STEP)
                              for step in _STEP * np.eye(len(at))], axis=1)
            rows.append(np.zeros((len(block), len(unknowns))))
            rows[-1][:, columns] = block
        return np.vstack(rows)

    def _columns(self, k: int) -> np.ndarray:
        """Unknowns on which strip ``k`` depends."""
        return np.array([*range(_SHARED), _SHARED + k, _SHARED + len(self.strips) + k])

    def _shape(self, shared: np.ndarray, sign: int, length: Metres, slope: Radians
               ) -> DeflectionCurve:
        alpha, curl = np.exp(shared[0]), sign * _CURL_UNIT * shared[2]
        return heavy_elastica(alpha, 1e-3 * shared[1] * alpha, weight=self.weight, length=length,
                              curl=curl, slope=slope, points=_POINTS, steps=_STEPS)

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
