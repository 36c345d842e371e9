"""The state of a cloth, of which everything measured is evidence, and its prior."""

from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from common.normal import Normal
from common.types import Density
from data.fabrics.fabrics import THETA_NAMES, ClothProperties, from_theta
from data.fabrics.prior import prior_from_content
from data.fabrics.prior.base import log_stiffness
from data.fabrics.prior.even import draw_fabrics
from sim.material import DIRECTIONS, REFERENCE_DENSITY, is_admissible

if TYPE_CHECKING:
    from drapenet.network.checkpoint import Header

STATE = (*THETA_NAMES, "curl_warp", "curl_weft", "membrane", "hysteresis")
"""Theta, natural curvatures, 1/m, with the marked face up, the logarithm of the membrane stiffness,
N/m, and the share of hysteresis."""
_CURL_SHARES = ((1.0, 0.0), (0.5, 0.5), (0.0, 1.0))  # of the curvatures along warp and weft
_PRIOR_SAMPLES = 4000


def state_of(cloth: ClothProperties) -> np.ndarray:
    """(S, 10) values of :data:`STATE`."""
    return np.column_stack([cloth.theta, cloth.curl, np.log(cloth.membrane), cloth.hysteresis])


def cloth_of_state(state: np.ndarray) -> ClothProperties:
    """The inverse of :func:`state_of` for states (S, 10); shares of hysteresis are limited to 0 to
    1."""
    return ClothProperties(state[:, :6], state[:, 6:8], np.exp(state[:, 8]),
                           state[:, 9].clip(0.0, 1.0))


def possible(state: np.ndarray) -> np.ndarray:
    """(S,) whether a plate can have these moduli."""
    return is_admissible(*from_theta(state[:, :6]))


@lru_cache(maxsize=2)
def fabric_prior(header: "Header") -> ClothProperties:
    """Samples of the fabrics that the network answers for, with their nuisances."""
    stated, nuisances, rng = header.prior, header.nuisances, np.random.default_rng(0)
    prior = prior_from_content(stated.fabrics, origin=str(header.path))
    theta, _ = draw_fabrics(prior, _PRIOR_SAMPLES, even_share=stated.even_share,
                            anisotropy=stated.anisotropy, varied=stated.anisotropy_varied)
    drawn = [nuisances.sample(rng, rng, alpha=alpha) for alpha in
             np.exp(log_stiffness(theta)).tolist()]
    return ClothProperties(
        theta, np.array([[each.curl_warp, each.curl_weft] for each in drawn]),
        np.array([each.membrane for each in drawn]), np.array([each.hysteresis for each in drawn]))


def seen_along(direction: str) -> np.ndarray:
    """(3, 10): a strip's log alpha at 300 g/m², beta/alpha and natural curvature, which along the
    bias is the mean, of a state."""
    k = DIRECTIONS.index(direction)
    seen = np.zeros((3, len(STATE)))
    seen[0, k] = seen[1, 3 + k] = 1.0
    seen[2, 6:8] = _CURL_SHARES[k]
    return seen


def heavier(density: Density) -> np.ndarray:
    """(3,) what a strip's state at a density has more than at 300 g/m²."""
    return np.array([np.log(density / REFERENCE_DENSITY), 0.0, 0.0])


def prior_along(prior: ClothProperties, density: Density) -> dict[str, Normal]:
    """The prior of log alpha at a density, beta/alpha and natural curvature, by direction."""
    states = state_of(prior)
    return {direction: Normal.of(states @ seen_along(direction).T + heavier(density))
            for direction in DIRECTIONS}
