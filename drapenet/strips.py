"""Measured strips as evidence beside the captures of a fabric, or beside the fabric prior alone.

The likelihood of a direction's log alpha, beta/alpha and natural curvature by its strips is normal.
The samples of a posterior are moved by the affine map that takes the normal distribution of their
mean and covariance to its product with these likelihoods. Importance weights would leave few
samples, because strips are several times as accurate as a drape.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from scipy.special import ndtri

from common.command import compose_config
from common.errors import InputError
from common.types import Density, Theta
from data.dataset.config import Options, config_from_options
from data.fabrics.fabrics import from_theta
from data.fabrics.prior import load_prior
from data.fabrics.properties import ClothProperties
from drapenet.result.estimate import Estimate
from drapenet.sets import LEVEL, SPECIMEN
from sim.cantilever.posterior import StripPosterior
from sim.material import DIRECTIONS, MICRO, REFERENCE_DENSITY, is_admissible

ROUNDS = 6  # of the correction for the twist of free strips
_PRIOR_SAMPLES = 4000
_CURL_SHARES = ((1.0, 0.0), (0.5, 0.5), (0.0, 1.0))  # of the curvatures along warp and weft


def prior_estimate(density: Density, spread: Theta) -> Estimate:
    """Samples of the fabric prior and of the nuisances of fabrics, before any measurement."""
    rng = np.random.default_rng(0)
    nuisances = config_from_options(
        compose_config("generate", ["nuisances=real"], schema=Options)).sampling.nuisances
    drawn = [nuisances.sample(rng, rng) for _ in range(_PRIOR_SAMPLES)]
    theta = load_prior("gaussian").sample(_PRIOR_SAMPLES, rng)
    cloth = ClothProperties(
        theta, np.array([[each.curl_warp, each.curl_weft] for each in drawn]),
        np.array([each.membrane for each in drawn]), np.array([each.hysteresis for each in drawn]))
    return Estimate(cloth.chosen(is_admissible(*from_theta(theta))), DIRECTIONS, density, spread)


def require_marked(known: bool) -> None:
    """InputError if the direction of the warp is not ``known`` in the captures."""
    if not known:
        raise InputError("strips along the yarns need warp_direction_deg in every capture.yaml")


def with_strips(estimate: Estimate, strips: Mapping[str, StripPosterior]) -> Estimate:
    """The estimate with the ``strips`` of some directions, at its density, as evidence.

    InputError if the warp's direction is not known.
    """
    require_marked(estimate.names == DIRECTIONS)
    # The map moves everything that is correlated with the moduli but the share of hysteresis,
    # which has limits.
    cloth = estimate.cloth
    samples = np.column_stack([cloth.theta, cloth.curl, np.log(cloth.membrane)])
    mean, covariance = samples.mean(axis=0), np.cov(samples.T)
    precision, vector = np.linalg.inv(covariance), np.zeros(len(mean))
    heavier = np.array([np.log(estimate.density / REFERENCE_DENSITY), 0.0, 0.0])
    for direction, strip in strips.items():
        k = DIRECTIONS.index(direction)
        # A strip's log alpha, beta/alpha and natural curvature, which along the bias is the mean.
        seen = np.zeros((3, len(mean)))
        seen[0, k] = seen[1, 3 + k] = 1.0
        seen[2, 6:8] = _CURL_SHARES[k]
        own, towards = strip.likelihood()
        precision += seen.T @ own @ seen
        vector += seen.T @ (towards - own @ (heavier + seen @ mean))
    after = np.linalg.inv(precision)
    scale = np.linalg.cholesky(after) @ np.linalg.inv(np.linalg.cholesky(covariance))
    moved = mean + after @ vector + (samples - mean) @ scale.T
    moved = ClothProperties(moved[:, :6], moved[:, 6:8], np.exp(moved[:, 8]), cloth.hysteresis)
    possible = is_admissible(*from_theta(moved.theta))
    if not possible.any():
        raise InputError("no fabric has the moduli of these strips: check their directions, "
                         "lengths and the density")
    return replace(estimate, cloth=moved.chosen(possible))


def contradicting_strips(estimate: Estimate, strips: Mapping[str, StripPosterior]) -> list[str]:
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
