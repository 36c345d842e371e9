"""Stiffness of a fabric in stretch and shear from strips under weights, by a prior and a law.

Unknown are the logarithms of the stiffnesses along warp and weft and in shear, Poisson's ratio, for
each direction an initial friction, and for each specimen its difference from the fabric. A bias
strip alone can be long because its shear is soft or because its yarns are: the posterior is the sum
of those at each of several levels of the yarns, where everything is normal about the best fit
(Laplace's approximation).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares
from scipy.special import chdtrc

from common.findings import Finding
from common.normal import Normal
from common.types import Density, Metres
from data.readings.quantity import SPECIMEN_SCATTER, STANDARD_GRAVITY
from drapenet.measured.tension.law import E100, EB5, KES_SHEAR, compliance, extension, load, reach
from sim.material import BIAS, DIRECTIONS, REFERENCE_DENSITY, WARP, WEFT
from sim.tension import POISSON

NAMES = ("stretch along the warp", "stretch along the weft", "shear")
STRETCH = (200.0, 2000.0)
"""N/m at 300 g/m², limits of 68 % of a log-normal prior along warp and weft each. Assumed, and
wide: the first stretch of six apparel fabrics is 420 to 1700 (docs/physics.md), but a strip under
500 g, as FAST-3's E100, has 2 000 to 10 000."""
ALIKE = 0.8
"""Correlation of the logarithms along warp and weft. Assumed: they differ by some factor of two."""
SHEAR = (35.0, 330.0)
"""The same of the shear stiffness: shares of about 0.2 to 1.0 of an isotropic sheet's. Independent
of the stretch: of fabrics under 500 g the share is nearer to 0.02."""
USUAL = ((30.0, 320.0, 20_000.0), (30.0, 320.0, 20_000.0), (5.0, 5.0, 500.0))
"""N/m at 300 g/m²: least, least but of knits (configs/nuisances/real.yaml), and most as usual."""
POISSON_DEVIATION = 0.15
FRICTION = 1.0
"""N/m, standard deviation of the load that a strip bears before its yarns slip. Assumed: 2HG of
KES-FB1 is about 0.5 to 2 gf/cm, and a bias strip needs 2 HG."""
STIFFNESS_ERROR = 0.10  # relative, of one that is stated, such as G of KES-FB1: as of B
LOAD_ERROR = 0.01  # relative
WIDTH_ERROR = 1e-3  # m
MACHINE_ERROR = 1e-4  # m, of an extension: FAST-3 reads 0.1 %
_PLACE = {WARP: 0, WEFT: 1, BIAS: 2}  # among the unknowns, by the direction of strips
_DIFFERENT = 0.01  # probability that strips of one direction are said to differ
_WINDOW = 0.5  # deviation of a window, in those of the prior
_LEVELS = np.arange(-3.5, 3.6, _WINDOW)
_SAMPLES = 4000
_SHARED = 7  # unknowns: three stiffnesses, Poisson's ratio, friction of three directions


@dataclass(frozen=True)
class MeasuredExtension:
    """A strip that a load stretches; errors are standard deviations."""

    direction: int  # its number
    load: float  # N/m
    load_error: float  # relative
    width: Metres
    gauge: Metres  # between the marks
    margin: Metres  # from each mark to its clamp
    extension: Metres  # of the gauge
    error: Metres  # of the extension
    specimen: str = ""
    typed: bool = False  # the value of a tester

    def reach(self, stiffness: tuple[np.ndarray, np.ndarray, np.ndarray], poisson: float
              ) -> np.ndarray:
        """:func:`drapenet.measured.tension.law.reach` of its marks, of stiffnesses (...,), N/m."""
        return reach(self.direction, stiffness, poisson, gauge=self.gauge / self.width,
                     margin=self.margin / self.width)

    def needed(self, stiffness: tuple[np.ndarray, np.ndarray, np.ndarray], poisson: float,
               strain: float | None = None) -> float:
        """Load, N/m, for the measured extension, or for another ``strain``, without friction, of
        stiffnesses (1,), N/m, or numbers."""
        strain = self.extension / self.gauge if strain is None else strain
        return float(load(strain / self.reach(stiffness, poisson),
                          compliance(self.direction, stiffness, poisson)))


@dataclass(frozen=True)
class TensionEvidence:
    """What strips say of the logarithms of the stiffnesses, N/m, along warp and weft and in shear,
    (S, 3) ``samples`` of the posterior."""

    samples: np.ndarray  # by a fixed seed
    measured: tuple[int, ...]  # numbers of the directions; a measurement along the bias is of shear
    poisson: float  # at the best fit
    friction: np.ndarray  # (3,) N/m, by direction, at the best fit
    findings: tuple[Finding, ...]  # of strips that contradict each other, and of unusual values

    @property
    def posterior(self) -> Normal:
        """The normal one with the medians and the 68 % intervals of the samples."""
        low, middle, high = np.quantile(self.samples, (0.16, 0.5, 0.84), axis=0)
        return Normal(middle, np.corrcoef(self.samples.T) * np.outer(high - low, high - low) / 4)

    @property
    def stiffness(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Samples of the stiffnesses along warp and weft and in shear, N/m."""
        warp, weft, shear = np.exp(self.samples).T
        return warp, weft, shear

    def readings(self) -> dict[str, np.ndarray]:
        """Samples of what testers would read of cloth that follows the law."""
        stiffness = self.stiffness
        compliances = [compliance(k, stiffness, self.poisson) for k in range(3)]
        clamped = reach(BIAS, stiffness, self.poisson, gauge=EB5.length / EB5.width, margin=0.0)
        return {"kes_g_gf_per_cm_deg": stiffness[2] / KES_SHEAR,
                "fast_eb5_percent": 100 * clamped * extension(EB5.load, compliances[BIAS]),
                "fast_e100_warp_percent": 100 * extension(E100.load, compliances[WARP]),
                "fast_e100_weft_percent": 100 * extension(E100.load, compliances[WEFT])}


def prior(density: Density) -> Normal:
    """Of the logarithms of the stiffnesses along warp and weft and in shear, N/m, at a density."""
    low, high = np.log([STRETCH, STRETCH, SHEAR]).T
    alike = np.array([[1, ALIKE, 0], [ALIKE, 1, 0], [0, 0, 1]])
    return Normal((low + high) / 2 + np.log(density / REFERENCE_DENSITY),
                  alike * np.outer(high - low, high - low) / 4)


def tension_evidence(
    strips: Sequence[MeasuredExtension], density: Density, stated: Mapping[int, float] = {}, *,
    knit: bool = False,
) -> TensionEvidence:
    """Evidence from strips, and from ``stated`` stiffnesses, N/m, by the number of the direction of
    strips that measure them; ``knit``: it is stated to be one."""
    fit = _Fit(strips, density, stated)
    found = least_squares(fit.residuals, fit.start, x_scale="jac", bounds=fit.bounds)
    samples = fit.samples(found.x)
    measured = {strip.direction for strip in strips} | {*stated}
    return TensionEvidence(
        samples, tuple(sorted(measured)), float(found.x[3]), found.x[4:_SHARED],
        (*fit.differing(found.x),
         *_unusual(np.exp(np.median(samples, axis=0)), density, measured, knit)))


class _Fit:
    """Residuals, in standard deviations, of the unknowns: stiffnesses, Poisson's ratio, frictions
    and differences of the specimens in their standard deviation."""

    def __init__(self, strips: Sequence[MeasuredExtension], density: Density,
                 stated: Mapping[int, float]) -> None:
        self.strips, self.stated, self.prior = strips, stated, prior(density)
        self.root = np.linalg.inv(np.linalg.cholesky(self.prior.covariance))
        names = [(strip.direction, strip.specimen) for strip in strips]
        self.specimen = [_SHARED + list(dict.fromkeys(names)).index(name) for name in names]
        self.size = _SHARED + len(set(names))
        self.bounds = np.array([[-np.inf, np.inf]] * 3 + [[-0.2, 0.8]]
                               + [[-np.inf, np.inf]] * (self.size - 4)).T
        self.start = np.zeros(self.size)
        self.start[:4] = *self.prior.mean, POISSON
        for strip in strips:  # from the prior the nearest fit may be another one
            strain = strip.extension / strip.gauge
            part = 4 if strip.direction == BIAS else 1
            self.start[_PLACE[strip.direction]] = np.log(strip.load / (part * strain))

    def residuals(self, x: np.ndarray) -> np.ndarray:
        """(R,) of the prior, of all other unknowns, of each strip, and of what is stated."""
        return np.concatenate([
            self.root @ (x[:3] - self.prior.mean), [(x[3] - POISSON) / POISSON_DEVIATION],
            x[4:_SHARED] / FRICTION, x[_SHARED:], self.of_strips(x),
            [self.of_stated(x, k) for k in self.stated]])

    def of_stated(self, x: np.ndarray, k: int) -> float:
        """Residual of the stiffness that is stated of a direction."""
        return float((x[_PLACE[k]] - np.log(self.stated[k])) / STIFFNESS_ERROR)

    def samples(self, best: np.ndarray) -> np.ndarray:
        """(S, 3) of the posterior. The windows of the levels, normal ones a deviation apart, add up
        to a constant."""
        start, parts = best.copy(), []
        deviation = np.sqrt(self.prior.covariance[:2, :2].mean())  # of the mean of both yarns
        for yarns in self.prior.mean[:2].mean() + _LEVELS * deviation:

            def window(x: np.ndarray, yarns: float = yarns) -> np.ndarray:
                return np.append(self.residuals(x),
                                 (x[:2].mean() - yarns) / (_WINDOW * deviation))

            start[:2] = best[:2] + yarns - best[:2].mean()
            found = least_squares(window, start, x_scale="jac", bounds=self.bounds)
            covariance = np.linalg.inv(found.jac.T @ found.jac)
            parts.append((np.linalg.slogdet(covariance)[1] / 2 - found.cost, found.x[:3],
                          covariance[:3, :3]))
        log_weight, means, covariances = map(np.array, zip(*parts, strict=True))
        weight = np.exp(log_weight - log_weight.max())
        weight /= weight.sum()
        rng = np.random.default_rng(0)
        part = rng.choice(len(weight), _SAMPLES, p=weight)
        return means[part] + np.einsum("kij,kj->ki", np.linalg.cholesky(covariances)[part],
                                       rng.standard_normal((_SAMPLES, 3)))

    def of_strips(self, x: np.ndarray) -> np.ndarray:
        """Residuals of the strips alone."""
        return np.array([
            (self.borne(x, k) / strip.load - 1)
            / np.hypot(strip.load_error, strip.error / strip.extension)
            for k, strip in enumerate(self.strips)])

    def borne(self, x: np.ndarray, k: int) -> float:
        """Load, N/m, of a strip at its extension."""
        strip, (warp, weft, shear) = self.strips[k], np.exp(x[:3])
        scatter = np.hypot(SPECIMEN_SCATTER, WIDTH_ERROR / strip.width)
        return float(x[4 + strip.direction] + np.exp(scatter * x[self.specimen[k]])
                     * strip.needed((warp, weft, shear), x[3]))

    def differing(self, x: np.ndarray) -> list[Finding]:
        """A finding for each direction of which strips and what is stated contradict each other."""
        found, residuals = [], self.of_strips(x)
        for k, direction in enumerate(DIRECTIONS):
            own = [i for i, strip in enumerate(self.strips) if strip.direction == k]
            count = len(own) + (k in self.stated) - 1
            if not own or count < 1:
                continue
            specimens = sorted({self.specimen[i] for i in own})
            squares = np.square([*residuals[own], *x[specimens], x[4 + k] / FRICTION]).sum()
            if k in self.stated:
                squares += self.of_stated(x, k) ** 2
            if chdtrc(count, squares) < _DIFFERENT:
                worst = max(own, key=lambda i: abs(np.log(max(self.borne(x, i), 1e-3)
                                                          / self.strips[i].load)))
                strip = self.strips[worst]
                found.append(Finding("tension_differs", {
                    "direction": direction, "value": 1e3 * strip.extension,
                    "load": 1e3 * strip.load * strip.width / STANDARD_GRAVITY,
                    "expected": 1e3 * self.borne(x, worst) * strip.width / STANDARD_GRAVITY}))
        return found


def _unusual(stiffness: np.ndarray, density: Density, measured: set[int], knit: bool
             ) -> list[Finding]:
    """A finding for each measured stiffness, N/m, that few fabrics of a density have."""
    limits = np.array(USUAL) * density / REFERENCE_DENSITY
    return [Finding("tension_soft" if low <= value <= high else "tension_unusual", {
        "what": name, "value": float(value), "low": float(low), "high": float(high)})
            for name, value, (low, soft, high), direction in zip(
                NAMES, stiffness, limits, (WARP, WEFT, BIAS), strict=True)
            if direction in measured and not (low if knit else soft) <= value <= high]
