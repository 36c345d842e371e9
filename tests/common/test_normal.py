"""Linear evidence: products of normal densities, and no information where a posterior is wider."""

import numpy as np
import pytest

from common.normal import Linear, Normal

RNG = np.random.default_rng(0)
ROOT = RNG.standard_normal((4, 4))
PRIOR = Normal(np.array([1.0, -2.0, 0.5, 0.0]), ROOT @ ROOT.T + np.eye(4))
SEEN = Linear(RNG.standard_normal((2, 4)), np.array([0.3, -1.0]))


def product(prior: Normal, evidence: Linear) -> Normal:
    """By precisions."""
    precision = np.linalg.inv(prior.covariance)
    covariance = np.linalg.inv(precision + evidence.rows.T @ evidence.rows)
    return Normal(covariance @ (precision @ prior.mean + evidence.rows.T @ evidence.values),
                  covariance)


def assert_same(one: Normal, other: Normal) -> None:
    assert one.mean == pytest.approx(other.mean, abs=1e-9)
    assert one.covariance == pytest.approx(other.covariance, abs=1e-9)


def test_evidence_gives_the_product_of_densities_and_is_found_from_it():
    posterior = PRIOR.updated(SEEN)
    assert_same(posterior, product(PRIOR, SEEN))
    found = Linear.between(PRIOR, posterior)
    assert found.rows.shape == (2, 4), "two directions were measured"
    assert found.rows.T @ found.rows == pytest.approx(SEEN.rows.T @ SEEN.rows, abs=1e-9)
    other = Normal(PRIOR.mean + 1, 3 * np.eye(4))
    assert_same(other.updated(found), product(other, SEEN))


def test_a_posterior_wider_than_its_prior_says_nothing_there():
    wider = Normal(PRIOR.mean + 0.3, 1.15 * PRIOR.covariance)
    assert Linear.between(PRIOR, wider).rows.shape == (0, 4)
    mixed = PRIOR.covariance.copy()
    mixed[0] *= 0.5
    mixed[:, 0] *= 0.5
    found = Linear.between(PRIOR, Normal(PRIOR.mean, mixed))
    assert (np.linalg.eigvalsh(PRIOR.covariance - PRIOR.updated(found).covariance) > -1e-9).all()
    stacked = Linear.stacked([found] * 8)
    np.linalg.cholesky(PRIOR.updated(stacked).covariance)


def test_parts_steps_and_scatter_are_those_of_the_measured_state():
    part = Linear(np.array([[2.0, 0.0], [0.0, 4.0]]), np.array([2.0, 0.0]))
    seen = np.eye(2, 4)
    assert_same(PRIOR.updated(part.of_part(seen)), product(PRIOR, Linear(part.rows @ seen,
                                                                         part.values)))
    # 1 ± 1/2 and 0 ± 1/4; moved by a step, with a scatter of 0.3 and 0.
    moved = part.moved(np.array([0.5, -1.0])).scattered(np.diag([0.09, 0.0]))
    flat = Normal(np.zeros(2), 1e8 * np.eye(2)).updated(moved)
    assert flat.mean == pytest.approx([1.5, -1.0], abs=1e-6)
    assert np.sqrt(np.diag(flat.covariance)) == pytest.approx([np.sqrt(0.25 + 0.09), 0.25])


def test_samples_have_the_moments_and_parts_are_marginal():
    drawn = Normal.of(PRIOR.samples(50_000))
    assert drawn.mean == pytest.approx(PRIOR.mean, abs=0.05)
    assert drawn.covariance == pytest.approx(PRIOR.covariance, abs=0.2)
    assert PRIOR.only([2, 0]).covariance[0, 1] == PRIOR.covariance[2, 0]
