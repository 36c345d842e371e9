"""Several captures of one fabric."""

import numpy as np
import pytest

from data.fabrics.prior import load_prior
from drapenet.result import joint
from drapenet.result.estimate import Estimate
from sim.material import DIRECTIONS, STIFF_SOFT, SWAPPED


def posterior(peak: np.ndarray, likelihood: np.ndarray, names: tuple[str, str, str]) -> Estimate:
    """Samples of a posterior whose likelihood is normal around ``peak`` with this covariance."""
    prior = joint.fabric_prior(names)
    precisions = np.linalg.inv(prior.covariance), np.linalg.inv(likelihood)
    covariance = np.linalg.inv(sum(precisions))
    mean = covariance @ (precisions[0] @ prior.mean + precisions[1] @ peak)
    draws = np.random.default_rng(0).multivariate_normal(mean, covariance, 20_000)
    return Estimate(draws, names, 0.0, 1.0, 0.2, prior.deviation)


def test_captures_count_once_each_and_the_prior_once(monkeypatch):
    monkeypatch.setattr(joint, "SHARED", 0.0)
    prior = joint.fabric_prior(DIRECTIONS)
    rng = np.random.default_rng(1)
    likelihood = np.diag((0.3 * prior.deviation) ** 2)
    peaks = prior.mean + rng.normal(0, 0.2, (3, 6)) * prior.deviation
    found = joint.joined([posterior(peak, likelihood, DIRECTIONS) for peak in peaks], "ABC")
    precisions = np.linalg.inv(prior.covariance), 3 * np.linalg.inv(likelihood)
    covariance = np.linalg.inv(sum(precisions))
    mean = covariance @ (precisions[0] @ prior.mean + precisions[1] @ peaks.mean(axis=0))
    scale = np.sqrt(np.diag(covariance))
    assert (found.samples.mean(axis=0) - mean) / scale == pytest.approx(np.zeros(6), abs=0.15)
    assert found.samples.std(axis=0) / scale == pytest.approx(np.ones(6), abs=0.05)
    assert not found.warnings


def test_errors_that_captures_share_do_not_average_out(monkeypatch):
    prior = joint.fabric_prior(DIRECTIONS)
    one = posterior(prior.mean, np.diag((0.1 * prior.deviation) ** 2), DIRECTIONS)
    monkeypatch.setattr(joint, "SHARED", 1.0)
    same = joint.joined([one] * 5, "ABCDE")
    assert same.samples.std(axis=0) == pytest.approx(one.samples.std(axis=0), rel=0.04)
    monkeypatch.setattr(joint, "SHARED", 0.25)
    better = joint.joined([one] * 5, "ABCDE")
    # Five captures count as 5 / (1 + 4/4).
    assert (better.samples.std(axis=0) / one.samples.std(axis=0))[:3] == pytest.approx(
        np.full(3, 0.4**0.5), rel=0.05)


def test_captures_of_another_fabric_are_named_and_no_other():
    prior = joint.fabric_prior(DIRECTIONS)
    likelihood = np.diag((0.1 * prior.deviation) ** 2)
    one = posterior(prior.mean, likelihood, DIRECTIONS)
    other = posterior(prior.mean + 1.5 * prior.deviation, likelihood, DIRECTIONS)
    line, = joint.joined([one, one, other], ["first", "second", "third"]).warnings
    assert line.startswith("third contradicts the other 2 captures: alpha ")
    line, = joint.joined([one, other], ["first", "second"]).warnings
    alpha = [0.2 / 0.3 * 1e6 * np.exp(own.samples[:, 0].mean()) for own in (one, other)]
    assert "first contradicts second: " in line and "limit 11.3" in line
    assert "alpha warp" not in line or f"{alpha[0]:.3g} against {alpha[1]:.3g} µN·m" in line
    two = joint.joined([one, other, one, other, one], "ABCDE").warnings
    assert {text[0] for text in two} == {"B", "D"}


def test_repeats_contradict_each_other_as_rarely_as_is_stated():
    """Captures whose errors have the covariance that the rule supposes, and specimens that vary."""
    rng, prior = np.random.default_rng(3), joint.fabric_prior(DIRECTIONS)
    deviation = 0.12
    draws = rng.normal(size=(500, 6)) * deviation
    found = {2: 0, 4: 0}
    for count in found:
        for _ in range(1000):
            own = rng.normal(size=(count, 3)) * np.hypot(
                deviation * np.sqrt(1 - joint.SHARED), joint.SPECIMEN)
            estimates = [Estimate(draws + prior.mean + np.append(shift, np.zeros(3)), DIRECTIONS,
                                  0.0, 1.0, 0.2, prior.deviation) for shift in own]
            found[count] += bool(joint.contradictions(estimates, "ABCD"[:count]))
    for alarms in found.values():
        assert 2 <= alarms <= 25  # 10 expected, with some correlation of the four


def test_the_prior_of_nameless_yarns_is_that_of_either_order():
    prior = load_prior("gaussian")
    known = joint.fabric_prior(DIRECTIONS)
    np.testing.assert_array_equal(known.covariance, prior.covariance)
    found = joint.fabric_prior(STIFF_SOFT)
    rng = np.random.default_rng(0)
    drawn = prior.sample(100_000, rng)
    drawn[::2] = drawn[::2][:, SWAPPED]
    scale = prior.deviation
    assert (drawn.mean(axis=0) - found.mean) / scale == pytest.approx(np.zeros(6), abs=0.02)
    gap = (np.cov(drawn.T) - found.covariance) / np.outer(scale, scale)
    assert np.abs(gap).max() < 0.03
