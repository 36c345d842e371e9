"""Measured strips and refined captures as evidence beside others, or beside the fabric prior alone.

Their likelihoods of a fabric's :data:`STATE` are normal. The samples of a posterior are moved by
the affine map that takes the normal distribution of their mean and covariance to its product with
these likelihoods. Importance weights would leave few samples, because strips and refined captures
are several times as accurate as the network.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import TYPE_CHECKING

import numpy as np
from scipy.special import ndtri

from common.command import compose_config
from common.errors import InputError
from common.types import Density, Theta
from data.fabrics.fabrics import THETA_NAMES, from_theta
from data.fabrics.prior import load_prior
from data.fabrics.properties import ClothProperties
from drapenet.result.estimate import Estimate
from drapenet.sets import LEVEL, SPECIMEN
from sim.material import DIRECTIONS, MICRO, REFERENCE_DENSITY, is_admissible

if TYPE_CHECKING:
    from data.strips.posterior import StripPosterior

STATE = (*THETA_NAMES, "curl_warp", "curl_weft", "membrane")
"""Theta, natural curvatures, 1/m, with the marked face up, and the logarithm of the membrane
stiffness, N/m; the share of hysteresis, which has limits, is not among them."""
ROUNDS = 6  # of the correction for the twist of free strips
_PRIOR_SAMPLES = 4000
_CURL_SHARES = ((1.0, 0.0), (0.5, 0.5), (0.0, 1.0))  # of the curvatures along warp and weft


@dataclass(frozen=True)
class Normal:
    """Mean (9,) and covariance (9, 9) of :data:`STATE`."""

    mean: np.ndarray
    covariance: np.ndarray

    @classmethod
    def of(cls, samples: np.ndarray) -> "Normal":
        """That of samples (S, 9)."""
        return cls(samples.mean(axis=0), np.cov(samples.T))

    def as_dict(self) -> dict[str, list]:
        """In JSON's types."""
        return {"names": list(STATE), "mean": self.mean.tolist(),
                "covariance": self.covariance.tolist()}


def state_of(cloth: ClothProperties) -> np.ndarray:
    """(S, 9) values of :data:`STATE`."""
    return np.column_stack([cloth.theta, cloth.curl, np.log(cloth.membrane)])


def cloth_of_state(state: np.ndarray, hysteresis: np.ndarray) -> ClothProperties:
    """The inverse of :func:`state_of`, with shares of hysteresis (S,)."""
    return ClothProperties(state[:, :6], state[:, 6:8], np.exp(state[:, 8]), hysteresis)


def prior_estimate(density: Density, spread: Theta) -> Estimate:
    """What is known before any measurement."""
    return Estimate(_prior_cloth(), DIRECTIONS, density, spread)


@cache
def _prior_cloth() -> ClothProperties:
    """Samples of the fabric prior and of the nuisances of fabrics."""
    from data.dataset.config import Options, config_from_options  # a third of a second

    rng = np.random.default_rng(0)
    nuisances = config_from_options(
        compose_config("generate", ["nuisances=real"], schema=Options)).sampling.nuisances
    drawn = [nuisances.sample(rng, rng) for _ in range(_PRIOR_SAMPLES)]
    theta = load_prior("gaussian").sample(_PRIOR_SAMPLES, rng)
    cloth = ClothProperties(
        theta, np.array([[each.curl_warp, each.curl_weft] for each in drawn]),
        np.array([each.membrane for each in drawn]), np.array([each.hysteresis for each in drawn]))
    return cloth.chosen(is_admissible(*from_theta(theta)))


def require_marked(known: bool) -> None:
    """InputError if the direction of the warp is not ``known`` in the captures."""
    if not known:
        raise InputError("strips along the yarns need warp_direction_deg in every capture.yaml")


def with_strips(estimate: Estimate, strips: Mapping[str, "StripPosterior"]) -> Estimate:
    """The estimate with the ``strips`` of some directions, at its density, as evidence.

    InputError if the warp's direction is not known.
    """
    require_marked(estimate.names == DIRECTIONS)
    samples = state_of(estimate.cloth)
    mean = samples.mean(axis=0)
    precision, vector = np.zeros((len(mean),) * 2), np.zeros(len(mean))
    heavier = np.array([np.log(estimate.density / REFERENCE_DENSITY), 0.0, 0.0])
    for direction, strip in strips.items():
        k = DIRECTIONS.index(direction)
        # A strip's log alpha, beta/alpha and natural curvature, which along the bias is the mean.
        seen = np.zeros((3, len(mean)))
        seen[0, k] = seen[1, 3 + k] = 1.0
        seen[2, 6:8] = _CURL_SHARES[k]
        own, towards = strip.likelihood()
        precision += seen.T @ own @ seen
        vector += seen.T @ (towards - own @ heavier)
    return updated(estimate, precision, vector)


def with_refined(estimate: Estimate, refined: Sequence[Normal]) -> Estimate:
    """The estimate with the ``refined`` posteriors of captures as evidence, in each of which the
    prior counts once."""
    prior = Normal.of(state_of(_prior_cloth()))
    known = np.linalg.inv(prior.covariance)
    precision, vector = np.zeros_like(known), np.zeros(len(known))
    for posterior in refined:
        own = np.linalg.inv(posterior.covariance)
        precision += own - known
        vector += own @ posterior.mean - known @ prior.mean
    return updated(estimate, precision, vector)


def updated(estimate: Estimate, precision: np.ndarray, vector: np.ndarray) -> Estimate:
    """The estimate with the log likelihood -x'P x/2 + h'x of its state x as evidence, P (9, 9) and
    h (9,)."""
    samples = state_of(estimate.cloth)
    before = Normal.of(samples)
    after = np.linalg.inv(np.linalg.inv(before.covariance) + precision)
    scale = np.linalg.cholesky(after) @ np.linalg.inv(np.linalg.cholesky(before.covariance))
    moved = (before.mean + after @ (vector - precision @ before.mean)
             + (samples - before.mean) @ scale.T)
    cloth = cloth_of_state(moved, estimate.cloth.hysteresis)
    possible = is_admissible(*from_theta(cloth.theta))
    if not possible.any():
        raise InputError("no fabric has these moduli: check directions, lengths, and the density")
    return replace(estimate, cloth=cloth.chosen(possible))


def contradicting_strips(estimate: Estimate, strips: Mapping[str, "StripPosterior"]) -> list[str]:
    """One line for each direction whose strips contradict the ``estimate`` from captures.

    The two-sided level of a direction's difference of log alpha is divided by the number of
    directions (Bonferroni); specimens differ as for captures.
    """
    limit = -float(ndtri(LEVEL / (2 * len(strips))))
    logs, lines = np.log(estimate.moduli()[0]), []
    for direction, strip in strips.items():
        drape = logs[:, DIRECTIONS.index(direction)]
        deviation = np.sqrt(drape.var() + strip.covariance[0, 0] + 2 * SPECIMEN**2)
        if abs(drape.mean() - strip.mean[0]) > limit * deviation:
            lines.append(
                f"the strips along the {direction} contradict the captures: alpha is "
                f"{strip.alpha / MICRO:.3g} against {np.exp(drape.mean()) / MICRO:.3g} µN·m; check "
                "fabric, direction, side and density, and leave one of them out")
    return lines
