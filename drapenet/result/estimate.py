"""The estimate of one fabric: posterior samples of its moduli, directions, density and warnings.

Medians, intervals, correlations and the band of the torque-curvature law are computed from the
samples. Network and refinement both give an :class:`Estimate`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from data.captures.capture import Capture
from data.fabrics.fabrics import fabric_from_theta, from_theta
from data.fabrics.prior import GaussianPrior
from drapenet.network.checkpoint import Header
from sim.material import (
    DIRECTIONS,
    FIRST,
    REFERENCE_DENSITY,
    SECOND,
    STIFF_SOFT,
    SWAPPED,
    Fabric,
    is_admissible,
)

if TYPE_CHECKING:
    from drapenet.network.predict import Draws

INTERVALS = {"interval_68": 0.68, "interval_90": 0.90}
MIN_DIRECTION_PROBABILITY = 0.8  # of the stiffer yarns' direction; below, there is a warning
MARK_TOLERANCE, MAX_MARK_ERROR = np.radians(10.0), np.radians(20.0)
"""Maximum angle from a marked warp to a sample's yarns to keep the sample; maximum median of it."""
MIN_AGREEING_SHARE = 0.25  # of samples that are kept at any angle from the mark
MAX_INADMISSIBLE_SHARE = 0.2  # of the network's samples


@dataclass(frozen=True)
class Estimate:
    """Posterior of a fabric's moduli.

    Attributes:
        samples: (S, 6) theta at 300 g/m² (:mod:`data.fabrics.fabrics`), in the order of ``names``.
        names: of the three directions, warp, bias, weft or stiff, bias, soft.
        axis: direction of the first yarns in the first view, rad in [0, pi).
        certainty: probability of that axis, from 0.5 to 1.
        density: kg/m², of the fabric.
        spread: (6,) standard deviation of theta over fabrics.
        warnings: one line each.
    """

    samples: np.ndarray
    names: tuple[str, str, str]
    axis: float
    certainty: float
    density: float
    spread: np.ndarray
    warnings: tuple[str, ...] = ()

    @property
    def convention(self) -> str:
        """``warp/weft`` or ``stiff/soft``."""
        return f"{self.names[0]}/{self.names[2]}"

    @property
    def theta(self) -> np.ndarray:
        """(6,) medians; if these are not admissible, the sample nearest to them."""
        middle = np.median(self.samples, axis=0)
        if is_admissible(*from_theta(middle)):
            return middle
        away = (self.samples - middle) / self.spread
        return self.samples[np.square(away).sum(axis=1).argmin()]

    @property
    def fabric(self) -> Fabric:
        """The fabric of :attr:`theta` at its density, with the first yarns as warp."""
        return fabric_from_theta(self.theta).at_density(self.density)

    @property
    def normal(self) -> GaussianPrior:
        """The normal distribution with the samples' mean and covariance."""
        return GaussianPrior(self.samples.mean(axis=0), np.cov(self.samples.T), fabrics=0)

    @property
    def constraint(self) -> np.ndarray:
        """(6,) standard deviation of each entry of theta divided by its spread over fabrics."""
        return self.samples.std(axis=0) / self.spread

    def moduli(self, density: float) -> tuple[np.ndarray, np.ndarray]:
        """alpha (S, 3) N·m and beta (S, 3) N·m² of a fabric of this ``density``, kg/m²."""
        alpha, beta = from_theta(self.samples)
        scale = density / REFERENCE_DENSITY
        return alpha * scale, beta * scale


def make_estimate(draws: "Draws", *, capture: Capture, header: Header) -> Estimate:
    """Make an estimate of posterior samples: directions in the order of their names, warnings."""
    theta, axis, certainty, doubts = _ordered(draws, capture.warp_direction)
    names = STIFF_SOFT if capture.warp_direction is None else DIRECTIONS
    estimate = Estimate(theta, names, axis % np.pi, certainty, capture.density, header.spread,
                        (*capture.warnings, *doubts))
    edges = np.array([header.fabrics.low, header.fabrics.high])
    low, high = np.stack([edges, edges[:, SWAPPED]], axis=1)
    outside = (estimate.theta < low.min(axis=0)) | (estimate.theta > high.max(axis=0))
    lines = [f"{name} lies outside the fabrics of the training set: an extrapolation"
             for name, out in zip(modulus_names(names), outside, strict=True) if out]
    if draws.impossible > MAX_INADMISSIBLE_SHARE:
        lines.append(f"{draws.impossible:.0%} of the posterior samples had moduli that no plate "
                     "can have, and were removed: check the specimen and the pictures")
    return replace(estimate, warnings=(*estimate.warnings, *lines))


def _ordered(
    draws: "Draws", warp: float | None
) -> tuple[np.ndarray, float, float, list[str]]:
    """Samples along common first yarns, their direction, rad, its probability, and warnings.

    The first yarns are the marked warp, or the stiffer yarns where none is marked.
    """
    soft = draws.theta[:, FIRST] < draws.theta[:, SECOND]
    stiff = draws.axis + soft * (np.pi / 2)
    first = np.angle(np.exp(2j * stiff).mean()) / 2 if warp is None else warp
    certainty = float((np.cos(2 * (stiff - first)) >= 0).mean()) if warp is None else 1.0
    along = np.cos(2 * (draws.axis - first)) >= 0
    theta = np.where(along[:, None], draws.theta, draws.theta[:, SWAPPED])
    doubts = []
    if certainty < MIN_DIRECTION_PROBABILITY:
        doubts.append("the direction of the stiffer yarns is uncertain (probability "
                      f"{certainty:.2f}): the fabric drapes alike along both yarns")
    # Angle to the nearer yarns of each sample; for a square it is the same for all samples.
    gap = np.abs(np.angle(np.exp(4j * (draws.axis - first)))) / 4
    if warp is not None:
        if np.median(gap) > MAX_MARK_ERROR:
            doubts.append(f"the marked warp lies {np.degrees(np.median(gap)):.0f}° from the yarns "
                          "estimated from the views: check warp_direction_deg")
        theta = theta[gap <= max(MARK_TOLERANCE, np.quantile(gap, MIN_AGREEING_SHARE))]
    return theta, float(first), certainty, doubts


def modulus_names(names: Sequence[str]) -> list[str]:
    """Names of theta's entries along the directions ``names``."""
    return [f"{what} {name}" for what in ("alpha", "beta/alpha") for name in names]


def quantiles(values: np.ndarray, level: float) -> list[float]:
    """[low, high] of the central interval of ``values`` (S,)."""
    return np.quantile(values, [(1 - level) / 2, (1 + level) / 2]).tolist()


def summary(values: np.ndarray) -> dict[str, Any]:
    """Median and intervals of ``values`` (S,), as in ``estimate.json``."""
    return {"median": float(np.median(values)),
            **{key: quantiles(values, level) for key, level in INTERVALS.items()}}
