"""Strips as evidence beside captures, and alone."""

from dataclasses import replace

import numpy as np
import pytest
from estimates import estimate_of

from common.errors import InputError
from data.fabrics.properties import ClothProperties
from data.strips.posterior import CURL_PRIOR, RATIO_PRIOR, StripPosterior
from drapenet.evidence import (
    Normal,
    contradicting_strips,
    prior_estimate,
    state_of,
    with_refined,
    with_strips,
)
from drapenet.result.estimate import Estimate
from sim.material import MICRO, STIFF_SOFT

DENSITY = 0.21
SPREAD = 0.3  # standard deviation of log alpha; 0.8 between two directions


def posterior(count: int = 40_000) -> Estimate:
    """Normal samples; log alpha of warp and weft are correlated, and curl with that of the warp."""
    rng, estimate = np.random.default_rng(0), estimate_of(
        np.full(3, 50 * MICRO), np.full(3, -1e-7), density=DENSITY)
    theta = np.tile(estimate.samples[0], (count, 1))
    white = rng.standard_normal((count, 9))
    theta[:, 0] += SPREAD * white[:, 0]
    theta[:, 1] += SPREAD * (0.6 * white[:, 0] + 0.8 * white[:, 1])
    theta[:, 2] += SPREAD * (0.8 * white[:, 0] + 0.6 * white[:, 2])
    theta[:, 3:] += 1e-4 * white[:, 3:6]
    curl = np.column_stack([3 * (0.5 * white[:, 0] + white[:, 6]), 3 * white[:, 7]])
    return replace(estimate, cloth=ClothProperties(
        theta, curl, 600 * np.exp(0.2 * white[:, 8]), np.full(count, 0.2)))


def strip(alpha: float, deviation: float) -> StripPosterior:
    """The posterior of strips that determine alpha, N·m, alone."""
    prior = np.diag([0.0, RATIO_PRIOR[1] ** -2, CURL_PRIOR**-2])
    return StripPosterior(np.array([np.log(alpha), RATIO_PRIOR[0], 0.0]),
                          np.linalg.inv(prior + np.diag([deviation**-2, 0, 0])), 1.0)


def test_a_strip_moves_what_is_correlated_with_its_direction():
    before, measured = posterior(), strip(60 * MICRO, SPREAD)
    after = with_strips(before, {"warp": measured})
    gap = np.log(60 / 50)
    mean = after.samples.mean(axis=0) - before.samples.mean(axis=0)
    # Both have the same deviation: halfway, and narrower by the root of 2.
    assert mean[:3] == pytest.approx([gap / 2, 0.6 * gap / 2, 0.8 * gap / 2], abs=0.004)
    assert after.samples[:, 0].std() == pytest.approx(SPREAD / np.sqrt(2), rel=0.02)
    assert after.cloth.curl[:, 0].mean() == pytest.approx(1.5 * gap / 2 / SPREAD, abs=0.05)
    assert np.corrcoef(after.samples[:, 1], before.samples[:, 1])[0, 1] > 0.98
    exact = with_strips(before, {"warp": strip(60 * MICRO, 1e-3)})
    assert np.median(exact.moduli()[0][:, 0]) == pytest.approx(60 * MICRO, rel=2e-3)


def test_strips_alone_leave_the_other_directions_to_the_prior():
    spread = np.array([0.9] * 3 + [1.4e-3] * 3)
    before = prior_estimate(DENSITY, spread)
    after = with_strips(before, {"weft": strip(40 * MICRO, 0.02)})
    assert after.density == DENSITY and after.constraint[2] == pytest.approx(0.02 / 0.9, rel=0.2)
    assert 0.2 < after.constraint[0] < before.constraint[0]


def test_contradictions_and_directions_that_are_not_known():
    before = posterior()
    assert not contradicting_strips(before, {"warp": strip(60 * MICRO, 0.02)})
    line, = contradicting_strips(before, {"warp": strip(52 * MICRO, 0.02),
                                          "weft": strip(200 * MICRO, 0.02)})
    assert "along the weft contradict" in line and "200 against 50 µN·m" in line
    with pytest.raises(InputError, match="warp_direction_deg"):
        with_strips(replace(before, names=STIFF_SOFT), {"warp": strip(60 * MICRO, 0.02)})


def test_refined_captures_count_the_prior_once():
    spread = np.array([0.9] * 3 + [1.4e-3] * 3)
    prior = Normal.of(state_of(prior_estimate(DENSITY, spread).cloth))
    known, seen = np.linalg.inv(prior.covariance), np.diag([25.0] * 3 + [1e5] * 3 + [0.1] * 2 + [4])
    measured = prior.mean + np.array([0.4, 0.3, 0.5, 0, 0, 0, 2, 0, 0.1])
    once = Normal(*_product(known, prior.mean, seen, measured))
    base = prior_estimate(DENSITY, spread)
    alone = Normal.of(state_of(with_refined(base, [once]).cloth))
    twice = Normal.of(state_of(with_refined(base, [once, once]).cloth))
    # Samples that no plate can have are removed, which moves the others a little.
    deviation = np.sqrt(np.diag(once.covariance))
    assert np.abs(alone.mean - once.mean).max() < 0.2 * deviation.max()
    expected = _product(known, prior.mean, 2 * seen, measured)
    assert np.abs((twice.mean - expected[0]) / deviation).max() < 0.3
    assert np.diag(twice.covariance) == pytest.approx(np.diag(expected[1]), rel=0.3)


def _product(
    precision: np.ndarray, mean: np.ndarray, other: np.ndarray, at: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Mean and covariance of the product of two normal densities."""
    covariance = np.linalg.inv(precision + other)
    return covariance @ (precision @ mean + other @ at), covariance
