"""The estimate of one fabric: samples of its moduli, with names, circumstances and doubts.

All that people see is taken from the samples: medians, intervals, correlations, the band of the
torque-curvature law. The network's answer and a refinement's are estimates alike.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from data.captures import Capture
from data.fabrics import fabric_from_theta, from_theta
from data.prior.gaussian import GaussianPrior
from drapenet.checkpoint import Header
from drapenet.convention import FIRST, SECOND, STIFF_SOFT, SWAPPED, WARP_WEFT
from sim.material import REFERENCE_DENSITY, Fabric, is_admissible

if TYPE_CHECKING:
    from drapenet.predict import Draws

INTERVALS = {"interval_68": 0.68, "interval_90": 0.90}
LEAST_SURE = 0.8  # probability of the stiffer yarns' direction, below which it is in doubt
MARK, DOUBTFUL_MARK = np.radians(10.0), np.radians(20.0)
"""How far from a marked warp a sample's yarns may lie to count; where their median is doubted."""
LEAST_AGREEING = 0.25  # share of samples that count however far they lie from the mark
MOST_IMPOSSIBLE = 0.2  # share of the network's samples


@dataclass(frozen=True)
class Estimate:
    """What is known of a fabric.

    Attributes:
        samples: (S, 6) theta at 300 g/m² (:mod:`data.fabrics`), in the order of ``names``.
        names: of the three directions, warp, bias, weft or stiff, bias, soft.
        axis: direction of the first yarns in the first view, rad in [0, pi).
        certainty: probability that those are the first yarns, from 0.5 to 1.
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
        """(6,) medians; where no cloth has them, the sample nearest to them."""
        middle = np.median(self.samples, axis=0)
        if is_admissible(*from_theta(middle)):
            return middle
        away = (self.samples - middle) / self.spread
        return self.samples[np.square(away).sum(axis=1).argmin()]

    @property
    def fabric(self) -> Fabric:
        """The fabric of :attr:`theta` at its density, the first yarns in place of the warp."""
        return fabric_from_theta(self.theta).at_density(self.density)

    @property
    def normal(self) -> GaussianPrior:
        """The normal distribution with the samples' mean and covariance."""
        return GaussianPrior(self.samples.mean(axis=0), np.cov(self.samples.T), fabrics=0)

    @property
    def constraint(self) -> np.ndarray:
        """(6,) standard deviation of each entry of theta over its spread over fabrics."""
        return self.samples.std(axis=0) / self.spread

    def moduli(self, density: float) -> tuple[np.ndarray, np.ndarray]:
        """alpha (S, 3) N·m and beta (S, 3) N·m² of a fabric of this ``density``, kg/m²."""
        alpha, beta = from_theta(self.samples)
        scale = density / REFERENCE_DENSITY
        return alpha * scale, beta * scale


def make_estimate(draws: "Draws", *, capture: Capture, header: Header) -> Estimate:
    """Name the directions, and say what is doubtful."""
    theta, axis, certainty, doubts = _ordered(draws, capture.warp_direction)
    names = STIFF_SOFT if capture.warp_direction is None else WARP_WEFT
    estimate = Estimate(theta, names, axis % np.pi, certainty, capture.density, header.spread,
                        (*capture.warnings, *doubts))
    edges = np.array([header.fabrics.low, header.fabrics.high])
    low, high = np.stack([edges, edges[:, SWAPPED]], axis=1)
    outside = (estimate.theta < low.min(axis=0)) | (estimate.theta > high.max(axis=0))
    lines = [f"{name} lies outside the fabrics of the training set: an extrapolation"
             for name, out in zip(modulus_names(names), outside, strict=True) if out]
    if draws.impossible > MOST_IMPOSSIBLE:
        lines.append(f"{draws.impossible:.0%} of what agrees with the views are moduli that no "
                     "plate can have, and were left out: check the specimen and the pictures")
    return replace(estimate, warnings=(*estimate.warnings, *lines))


def _ordered(
    draws: "Draws", warp: float | None
) -> tuple[np.ndarray, float, float, list[str]]:
    """Samples with one first yarn direction, that direction, rad, how certain it is, and doubts.

    It is the marked warp, or else that of the stiffer yarns.
    """
    soft = draws.theta[:, FIRST] < draws.theta[:, SECOND]
    stiff = draws.axis + soft * (np.pi / 2)
    first = np.angle(np.exp(2j * stiff).mean()) / 2 if warp is None else warp
    certainty = float((np.cos(2 * (stiff - first)) >= 0).mean()) if warp is None else 1.0
    along = np.cos(2 * (draws.axis - first)) >= 0
    theta = np.where(along[:, None], draws.theta, draws.theta[:, SWAPPED])
    doubts = []
    if certainty < LEAST_SURE:
        doubts.append("the direction of the stiffer yarns is uncertain (probability "
                      f"{certainty:.2f}): the fabric drapes alike along both yarns")
    # From the nearer yarns of each sample: of a square all alike, of a disc as it drapes.
    gap = np.abs(np.angle(np.exp(4j * (draws.axis - first)))) / 4
    if warp is not None:
        if np.median(gap) > DOUBTFUL_MARK:
            doubts.append(f"the marked warp lies {np.degrees(np.median(gap)):.0f}° from the yarns "
                          "found in the views: check warp_direction_deg")
        theta = theta[gap <= max(MARK, np.quantile(gap, LEAST_AGREEING))]
    return theta, float(first), certainty, doubts


def modulus_names(names: Sequence[str]) -> list[str]:
    """Names of theta's entries along the directions ``names``."""
    return [f"{what} {name}" for what in ("alpha", "beta/alpha") for name in names]


def quantiles(values: np.ndarray, level: float) -> list[float]:
    """[low, high] of the central interval of ``values`` (S,)."""
    return np.quantile(values, [(1 - level) / 2, (1 + level) / 2]).tolist()


def summary(values: np.ndarray) -> dict[str, Any]:
    """Median and intervals of ``values`` (S,), as files show them."""
    return {"median": float(np.median(values)),
            **{key: quantiles(values, level) for key, level in INTERVALS.items()}}
