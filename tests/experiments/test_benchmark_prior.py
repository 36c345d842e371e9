"""The yardsticks by which priors are compared."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from data.fabrics.fabrics import FabricTable, from_theta
from data.fabrics.prior import Architecture, Coordinates, VaePrior, load_prior, plausible_range
from experiments.estimation.prior import (
    MixturePrior,
    compare,
    log_likelihood,
    log_volume,
    split_rows,
)
from tests.data.test_prior import linear_vae


@pytest.fixture(scope="module")
def theta():
    return load_prior("gaussian").sample(120, np.random.default_rng(0))


def test_a_split_takes_every_row_once(theta):
    split = split_rows(theta, 3)
    assert (len(split.fitted), len(split.unseen)) == (96, 24)
    both = np.vstack([split.fitted, split.unseen])
    np.testing.assert_array_equal(np.sort(both, axis=0), np.sort(theta, axis=0))
    assert (split_rows(theta, 4).unseen != split.unseen).any()


def test_models_are_compared_by_mean_and_standard_error(theta):
    alpha, beta = from_theta(theta)
    table = FabricTable(np.full(120, 0.3), alpha, beta, np.full(120, 5))
    found = compare(table, ["gaussian"], splits=3)
    assert (found["fabrics"], found["unseen"]) == (120, 24)
    runs, (mean, error) = found["runs"]["gaussian"], found["models"]["gaussian"][
        "log_likelihood_unseen"]
    assert mean == pytest.approx(np.mean(runs))
    assert error == pytest.approx(np.std(runs, ddof=1) / 3**0.5)
    assert found["models"]["gaussian"]["log_likelihood_fitted"][0] > mean


@pytest.fixture(scope="module")
def mixture(theta):
    return MixturePrior.fit(theta, components=3)


@pytest.fixture(scope="module")
def vae(theta):
    return VaePrior.fit(theta, architecture=Architecture((8, 6), 2, steps=600))


def test_volume_is_the_determinant_of_the_coordinates(theta):
    coordinates, at = Coordinates.fit(theta)[0], theta[3]
    steps = np.diag([1e-6] * 3 + [1e-9] * 3)
    jacobian = [(coordinates.encode(at + h) - coordinates.encode(at - h)) / (2 * h.max())
                for h in steps]
    expected = np.linalg.slogdet(jacobian)[1]
    assert log_volume(coordinates, at) == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize("name", ["mixture", "vae"])
def test_density_integrates_to_one(name, request):
    """Importance sampling of the density's integral, from a normal distribution a bit wider."""
    prior, rng = request.getfixturevalue(name), np.random.default_rng(5)
    own = prior.coordinates.encode(prior.sample(2000, rng))
    proposal = multivariate_normal(own.mean(axis=0), 1.5 * np.cov(own.T))
    points = proposal.rvs(20_000, random_state=rng)
    theta = prior.coordinates.decode(points)
    log_density = log_likelihood(prior, theta) - log_volume(prior.coordinates, theta)
    ratio = np.exp(log_density - proposal.logpdf(points))
    error = ratio.std() / np.sqrt(len(ratio))
    assert error < 0.03
    assert abs(ratio.mean() - 1) < 4 * error


def test_samples_of_a_mixture_have_its_mean_and_covariance(mixture):
    points = mixture.coordinates.encode(mixture.sample(20_000, np.random.default_rng(1)))
    mean = mixture.weights @ mixture.means
    away = mixture.means - mean
    covariance = np.einsum("k,kij->ij", mixture.weights, mixture.covariances
                           + away[:, :, None] * away[:, None])
    np.testing.assert_allclose(points.mean(axis=0), mean, atol=0.04)
    np.testing.assert_allclose(np.cov(points.T), covariance, atol=0.06)


def test_bound_is_exact_with_the_exact_encoder_and_below_with_another(theta):
    coordinates = Coordinates.fit(theta)[0]
    prior, covariance = linear_vae(coordinates, np.random.default_rng(3), exact=True)
    fabrics = prior.sample(200, np.random.default_rng(4))
    exact = (multivariate_normal(np.zeros(6), covariance).logpdf(coordinates.encode(fabrics))
             + log_volume(coordinates, fabrics))
    # Every importance weight is the likelihood itself, but for float32.
    np.testing.assert_allclose(log_likelihood(prior, fabrics, draws=1), exact, atol=1e-4)
    off, _ = linear_vae(coordinates, np.random.default_rng(3), exact=False)
    loss = [(exact - log_likelihood(off, fabrics, draws=draws)).mean() for draws in (1, 10, 1000)]
    assert loss[0] > 0.2 and loss[1] < 0.6 * loss[0] and loss[2] < 0.1 * loss[1]
    assert loss[2] > -1e-3


def test_training_beats_independent_normal_coordinates(theta, vae):
    clipped = np.clip(theta, *plausible_range(theta))
    points = Coordinates.fit(theta)[1]
    independent = (-0.5 * points**2 - 0.5 * np.log(2 * np.pi)).sum(axis=1)
    independent += log_volume(vae.coordinates, clipped)
    assert log_likelihood(vae, clipped).mean() > independent.mean() + 0.5
