"""The estimate of one fabric by network or refinement: samples of its moduli, axis, density."""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from common.types import Density, Radians, Theta
from data.fabrics.fabrics import fabric_from_theta, from_theta
from data.fabrics.prior import GaussianPrior
from sim.material import (
    DIRECTIONS,
    FIRST,
    REFERENCE_DENSITY,
    SECOND,
    STIFF_SOFT,
    SWAPPED,
    Fabric,
    is_admissible,
    torque,
)

if TYPE_CHECKING:
    from data.captures.capture import Capture
    from drapenet.network.checkpoint import Header
    from drapenet.network.predict import Draws

MIN_DIRECTION_PROBABILITY = 0.8  # of the stiffer yarns' direction; below, there is a warning
MARK_TOLERANCE, MAX_MARK_ERROR = np.radians(10.0), np.radians(20.0)
"""Maximum angle from a marked warp to a sample's yarns to keep the sample; maximum median of it."""
MIN_AGREEING_SHARE = 0.25  # of samples that are kept at any angle from the mark
MAX_INADMISSIBLE_SHARE = 0.2  # of the network's samples


@dataclass(frozen=True)
class Estimate:
    """Posterior of a fabric's moduli.

    Attributes:
        samples: (S, 6).
        names: of the directions: warp, bias, weft or stiff, bias, soft.
        axis: direction of the first yarns in the first view, in [0, pi).
        certainty: probability of that axis, from 0.5 to 1.
        spread: standard deviation of theta over fabrics.
        warnings: of the samples alone, one line each.
    """

    samples: Theta
    names: tuple[str, str, str]
    axis: Radians
    certainty: float
    density: Density
    spread: Theta
    warnings: tuple[str, ...] = ()

    @property
    def theta(self) -> Theta:
        """Medians; if these are not admissible, the sample nearest to them."""
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
    def modulus_names(self) -> list[str]:
        """Names of theta's entries."""
        return [f"{what} {name}" for what in ("alpha", "beta/alpha") for name in self.names]

    @property
    def constraint(self) -> np.ndarray:
        """(6,) standard deviation of each entry of theta divided by its spread over fabrics."""
        return self.samples.std(axis=0) / self.spread

    def moduli(self, density: Density | None = None) -> tuple[np.ndarray, np.ndarray]:
        """alpha (S, 3) N·m and beta (S, 3) N·m² at this ``density``, kg/m², or at the fabric's."""
        alpha, beta = from_theta(self.samples)
        scale = (self.density if density is None else density) / REFERENCE_DENSITY
        return alpha * scale, beta * scale

    def torques(self, direction: int, curvature: np.ndarray) -> np.ndarray:
        """(S, C) torque per width, N, of each sample at ``curvature`` (C,), 1/m."""
        return torque(curvature, *(part[:, direction, None] for part in self.moduli()))


def make_estimate(draws: "Draws", *, capture: "Capture", header: "Header") -> Estimate:
    """Make an estimate of posterior samples: directions in the order of their names, warnings.

    The first yarns are the marked warp, or the stiffer yarns where none is marked.
    """
    warp = capture.warp_direction
    soft = draws.theta[:, FIRST] < draws.theta[:, SECOND]
    stiff = draws.axis + soft * (np.pi / 2)
    first = np.angle(np.exp(2j * stiff).mean()) / 2 if warp is None else warp
    certainty = float((np.cos(2 * (stiff - first)) >= 0).mean()) if warp is None else 1.0
    along = np.cos(2 * (draws.axis - first)) >= 0
    theta = np.where(along[:, None], draws.theta, draws.theta[:, SWAPPED])
    warnings = []
    if certainty < MIN_DIRECTION_PROBABILITY:
        warnings.append("the direction of the stiffer yarns is uncertain (probability "
                        f"{certainty:.2f}): the fabric drapes alike along both yarns")
    if warp is not None:
        # Angle to the nearer yarns of each sample; for a square it is the same for all samples.
        gap = np.abs(np.angle(np.exp(4j * (draws.axis - first)))) / 4
        if np.median(gap) > MAX_MARK_ERROR:
            warnings.append(f"the marked warp lies {np.degrees(np.median(gap)):.0f}° from the "
                            "yarns estimated from the views: check warp_direction_deg")
        theta = theta[gap <= max(MARK_TOLERANCE, np.quantile(gap, MIN_AGREEING_SHARE))]
    names = STIFF_SOFT if warp is None else DIRECTIONS
    estimate = Estimate(theta, names, float(first) % np.pi, certainty, capture.density,
                        header.spread)
    warnings += _extrapolations(estimate, header)
    if draws.impossible > MAX_INADMISSIBLE_SHARE:
        warnings.append(f"{draws.impossible:.0%} of the posterior samples had moduli that no plate "
                        "can have, and were removed: check the specimen and the pictures")
    return replace(estimate, warnings=tuple(warnings))


def _extrapolations(estimate: Estimate, header: "Header") -> list[str]:
    """One line for each modulus outside the fabrics trained on, in either order of the yarns."""
    edges = np.array([header.fabrics.low, header.fabrics.high])
    low, high = np.stack([edges, edges[:, SWAPPED]], axis=1)
    outside = (estimate.theta < low.min(axis=0)) | (estimate.theta > high.max(axis=0))
    return [f"{name} lies outside the fabrics of the training set: an extrapolation"
            for name, out in zip(estimate.modulus_names, outside, strict=True) if out]
