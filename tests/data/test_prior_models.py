"""Mixtures and autoencoders as priors, against closed forms and each other."""

import base64
import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from safetensors.numpy import load, save
from scipy.stats import multivariate_normal
from sklearn.mixture import GaussianMixture

from common.errors import InputError
from data.fabrics.fabrics import from_theta, read_fabric_table
from data.fabrics.prior import (
    BUNDLED,
    MODELS,
    MixturePrior,
    VaePrior,
    load_prior,
    prior_content,
    prior_from_content,
    sample_admissible,
    save_prior,
)
from data.fabrics.prior.coordinates import Coordinates, plausible_range
from data.fabrics.prior.mixture import VARIANCE_FLOOR
from data.fabrics.prior.vae import SIGMA_MIDDLE, SIGMA_REACH, Architecture
from sim.material import plate_constants, torque

TABLE = Path(__file__).parents[3] / "shared" / "fabrics" / "feng2022_train.csv"
needs_table = pytest.mark.skipif(not TABLE.exists(), reason="the published table is not here")
BUNDLED_SAMPLES = [
    [-11.091846259595, -10.351344689846, -11.252473064778,
     -0.004254547201, -0.003956803517, -0.004009851007],
    [-10.376505109932, -10.334575213839, -10.529027655398,
     -0.001930066245, -0.002557332901, -0.002677146884],
]
SMALL = Architecture((8, 6), 2, steps=60)


@pytest.fixture(scope="module")
def theta():
    """120 fabrics drawn from the bundled Gaussian, with one outlier."""
    fabrics = load_prior("gaussian").sample(120, np.random.default_rng(0))
    fabrics[7, 3] = 0.04
    return fabrics


@pytest.fixture(scope="module")
def mixture(theta):
    return MixturePrior.fit(theta, components=3)


@pytest.fixture(scope="module")
def vae(theta):
    return VaePrior.fit(theta, architecture=SMALL)


@pytest.fixture(params=["mixture", "vae"])
def prior(request):
    return request.getfixturevalue(request.param)


def linear_vae(coordinates: Coordinates, rng: np.random.Generator, *, exact: bool):
    """An autoencoder of linear layers, whose fabrics are normally distributed, and that normal
    distribution's covariance; its encoder is the exact one, or one that is off."""
    latent = 2
    mixing = rng.normal(0, 0.8, (6, latent))
    sigma = rng.uniform(0.4, 0.8, 6)
    output = np.arctanh((np.log(sigma) - SIGMA_MIDDLE) / SIGMA_REACH)
    precision = np.eye(latent) + (mixing.T / sigma**2) @ mixing
    # The exact posterior is correlated; axes along which it is not make it one of the family.
    turn = np.linalg.eigh(precision)[1]
    mixing = mixing @ turn
    variance = 1 / np.diag(np.eye(latent) + (mixing.T / sigma**2) @ mixing)
    gain = variance[:, None] * (mixing.T / sigma**2)
    if not exact:
        gain, variance = 0.7 * gain, 1.6 * variance
    weights = {
        "encoder.0.weight": np.vstack([gain, np.zeros((latent, 6))]),
        "encoder.0.bias": np.concatenate([np.zeros(latent), np.log(variance)]),
        "decoder.0.weight": np.vstack([mixing, np.zeros((6, latent))]),
        "decoder.0.bias": np.concatenate([np.zeros(6), output]),
    }
    weights = {name: array.astype(np.float32) for name, array in weights.items()}
    prior = VaePrior(coordinates=coordinates, weights=weights, fabrics=100, shift=0.0,
                     spread=(1.0, 1.0))
    return prior, mixing @ mixing.T + np.diag(sigma**2)


def test_coordinates_invert_and_stretch_as_their_volume_says(theta):
    coordinates, points = Coordinates.fit(theta)
    np.testing.assert_allclose(points.mean(axis=0), 0, atol=1e-12)
    np.testing.assert_allclose(points.std(axis=0), 1)
    np.testing.assert_allclose(coordinates.decode(coordinates.encode(theta)), theta, rtol=1e-9)
    at = theta[3]
    steps = np.diag([1e-6] * 3 + [1e-9] * 3)
    jacobian = [(coordinates.encode(at + h) - coordinates.encode(at - h)) / (2 * h.max())
                for h in steps]
    expected = np.linalg.slogdet(jacobian)[1]
    assert coordinates.log_volume(at) == pytest.approx(expected, abs=1e-6)


def test_an_outlier_is_drawn_in_and_drawing_in_twice_changes_nothing(theta):
    low, high = plausible_range(theta)
    assert high[3] < 0.01 < theta[7, 3]
    drawn = np.clip(theta, low, high)
    assert (drawn != theta).sum() < 5
    np.testing.assert_allclose(plausible_range(drawn), (low, high), rtol=1e-9)
    fits = [MixturePrior.fit(fabrics, components=3) for fabrics in (theta, drawn)]
    np.testing.assert_allclose(fits[0].means, fits[1].means, rtol=1e-6)


def test_mixture_has_the_likelihood_that_scikit_learn_gives_it(theta, mixture):
    points = Coordinates.fit(theta)[1]
    library = GaussianMixture(3, max_iter=200, n_init=5, reg_covar=VARIANCE_FLOOR,
                              random_state=0).fit(points)
    drawn = np.clip(theta, *plausible_range(theta))
    expected = library.score_samples(points) + mixture.coordinates.log_volume(drawn)
    np.testing.assert_allclose(mixture.log_likelihood(drawn), expected, rtol=1e-9)


def test_density_integrates_to_one(prior):
    """Importance sampling of the density's integral, from a normal distribution a bit wider."""
    rng = np.random.default_rng(5)
    own = prior.coordinates.encode(prior.sample(2000, rng))
    proposal = multivariate_normal(own.mean(axis=0), 1.5 * np.cov(own.T))
    points = proposal.rvs(20_000, random_state=rng)
    theta = prior.coordinates.decode(points)
    log_density = prior.log_likelihood(theta) - prior.coordinates.log_volume(theta)
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
             + coordinates.log_volume(fabrics))
    # Every importance weight is the likelihood itself, but for float32.
    np.testing.assert_allclose(prior.log_likelihood(fabrics, draws=1), exact, atol=1e-4)
    off, _ = linear_vae(coordinates, np.random.default_rng(3), exact=False)
    loss = [(exact - off.log_likelihood(fabrics, draws=draws)).mean() for draws in (1, 10, 1000)]
    assert loss[0] > 0.2 and loss[1] < 0.6 * loss[0] and loss[2] < 0.1 * loss[1]
    assert loss[2] > -1e-3


def test_samples_of_a_vae_are_its_model_and_widening_widens_its_latents(theta):
    coordinates = Coordinates.fit(theta)[0]
    prior, covariance = linear_vae(coordinates, np.random.default_rng(3), exact=True)
    mixing = prior.weights["decoder.0.weight"][:6].astype(float)
    # Variance of the mean, 1/12; mean of the squared deviation, 1 + 0.4²/12.
    widened_covariance = covariance + (1 / 12 + 0.4**2 / 12) * mixing @ mixing.T
    widened = replace(prior, shift=0.5, spread=(0.8, 1.2))
    for model, expected in ((prior, covariance), (widened, widened_covariance)):
        points = coordinates.encode(model.sample(20_000, np.random.default_rng(6)))
        deviation = np.sqrt(np.diag(expected))
        difference = (np.cov(points.T) - expected) / np.outer(deviation, deviation)
        assert np.abs(difference).max() < 0.03  # three standard errors; widening adds 0.09


def test_samples_are_reproducible_and_extend(prior):
    long = prior.sample(6, np.random.default_rng(3))
    rng = np.random.default_rng(3)
    one_by_one = np.vstack([prior.sample(1, rng) for _ in range(6)])
    np.testing.assert_array_equal(long, one_by_one)


def test_training_learns_and_repeats(theta, vae):
    again = VaePrior.fit(theta, architecture=SMALL)
    assert prior_content(again) == prior_content(vae)
    other = VaePrior.fit(theta, architecture=SMALL, seed=1)
    assert prior_content(other) != prior_content(vae)
    longer = VaePrior.fit(theta, architecture=replace(SMALL, steps=600))
    drawn = np.clip(theta, *plausible_range(theta))
    gain = longer.log_likelihood(drawn).mean() - vae.log_likelihood(drawn).mean()
    # The best normal distribution of independent coordinates is what training must beat.
    points = Coordinates.fit(theta)[1]
    independent = (-0.5 * points**2 - 0.5 * np.log(2 * np.pi)).sum(axis=1)
    independent += longer.coordinates.log_volume(drawn)
    assert gain > 0.2
    assert longer.log_likelihood(drawn).mean() > independent.mean() + 0.5


def test_files_are_read_back_bit_by_bit(prior, tmp_path):
    save_prior(prior, tmp_path / "p.json")
    loaded = load_prior(tmp_path / "p.json")
    assert prior_content(loaded) == prior_content(prior)
    np.testing.assert_array_equal(loaded.sample(5, np.random.default_rng(1)),
                                  prior.sample(5, np.random.default_rng(1)))
    np.testing.assert_array_equal(loaded.log_likelihood(prior.sample(3, np.random.default_rng(2))),
                                  prior.log_likelihood(prior.sample(3, np.random.default_rng(2))))


@pytest.mark.parametrize(("change", "complaint"), [
    ({"weights": [0.5, 0.6, 0.1]}, "add up to 1"),
    ({"weights": [1.0]}, "equal in number"),
    ({"weights": []}, "weights: "),
    ({"means": None}, "means: give K × 6 finite"),
    ({"covariances": [(-np.eye(6)).tolist()] * 3}, "positive definite"),
    ({"coordinates": None}, "coordinates: "),
    ({"coordinates": {"mean": [0] * 6, "scale": [0] * 6, "bend": 2e-3}}, "must be positive"),
    ({"coordinates": {"mean": [0] * 6, "scale": [1] * 6, "bend": 1}}, "coordinates.bend: must be"),
    ({"fabrics": -1}, "fabrics"),
])
def test_bad_mixtures_are_refused(mixture, change, complaint):
    content = json.loads(json.dumps(prior_content(mixture))) | change
    with pytest.raises(InputError, match=complaint) as refusal:
        prior_from_content(content, origin="p.json")
    assert "\n" not in str(refusal.value) and str(refusal.value).startswith("p.json")


def changed_weights(vae, change):
    weights = load(base64.b64decode(vae.as_dict()["weights"]))
    change(weights)
    return {"weights": base64.b64encode(save(weights)).decode()}


@pytest.mark.parametrize(("change", "complaint"), [
    (lambda vae: {"weights": "AAAA"}, "must be base64 of a safetensors"),
    (lambda vae: {"weights": "ä"}, "must be base64 of a safetensors"),
    (lambda vae: {"weights": None}, "must be base64 of a safetensors"),
    (lambda vae: {"shift": -1}, "shift: "),
    (lambda vae: {"shift": 1e308}, "shift: "),
    (lambda vae: {"spread": [1.2, 0.8]}, "spread: "),
    (lambda vae: changed_weights(vae, lambda w: w.pop("decoder.1.bias")), "6 numbers"),
    (lambda vae: changed_weights(vae, lambda w: w.clear()), "6 numbers"),
    (lambda vae: changed_weights(vae, lambda w: w.update(more=np.ones(2, np.float32))),
     "6 numbers"),
    (lambda vae: changed_weights(
        vae, lambda w: w.update({"encoder.0.weight": np.ones((3, 3), np.float32)})), "6 numbers"),
    (lambda vae: changed_weights(
        vae, lambda w: w.update({"encoder.0.bias": np.full(8, np.nan, np.float32)})), "finite"),
    (lambda vae: changed_weights(
        vae, lambda w: w.update({"encoder.0.bias": np.zeros(8)})), "float32"),
])
def test_bad_autoencoders_are_refused(vae, change, complaint):
    content = prior_content(vae) | change(vae)
    with pytest.raises(InputError, match=complaint) as refusal:
        prior_from_content(content, origin="p.json")
    assert "\n" not in str(refusal.value)


def test_negative_zero_is_no_shift(vae):
    zero, negative = (prior_from_content(prior_content(vae) | {"shift": shift}, origin="p.json")
                      for shift in (0.0, -0.0))
    draws = [prior.sample(3, np.random.default_rng(1)) for prior in (zero, negative)]
    np.testing.assert_array_equal(*draws)


def test_fitting_refuses_too_few_or_equal_fabrics(theta):
    with pytest.raises(InputError, match="40 distinct fabrics; a prior needs at least 49"):
        MODELS["gmm7"](theta[:40])
    with pytest.raises(InputError, match="at least 20"):
        MODELS["vae4"](theta[:10])
    for shared in (21, 40):
        fabrics = theta[:40].copy()
        fabrics[:shared, 3] = -2e-3 * (1 + 1e-16 * np.arange(shared))  # equal but for rounding
        with pytest.raises(InputError, match=r"more than half .* beta_over_alpha_warp"):
            MODELS["gmm3"](fabrics)


@pytest.mark.parametrize("name", BUNDLED)
def test_fabrics_of_the_bundled_priors_resist_bending_in_every_direction(name):
    prior, rng = load_prior(name), np.random.default_rng(8)
    curvature = np.linspace(1, 500, 200)  # 1/m; drapes visit some 300
    angle = np.linspace(0, np.pi / 2, 61)
    draws = [sample_admissible(prior, rng) for _ in range(300)]
    assert sum(rejected for _, rejected in draws) < 0.02 * len(draws)
    for theta, _ in draws:
        alpha, beta = from_theta(theta)
        for a, b in zip(alpha, beta, strict=True):
            assert (np.diff(torque(curvature, a, b)) > 0).all() and torque(1.0, a, b) > 0
        # Eq. 8 of Feng et al. 2022, between neighbouring sample directions, and our plate's.
        share = np.sin(angle) ** 2
        near_weft = alpha[2] + 2 * (1 - share) * (alpha[1] - alpha[2])
        near_warp = alpha[0] + 2 * share * (alpha[1] - alpha[0])
        assert np.where(angle > np.pi / 4, near_weft, near_warp).min() > 0
        a11, a22, a12, a66 = plate_constants(alpha)
        c, s = np.cos(angle) ** 2, share
        assert (a11 * c**2 + a22 * s**2 + (2 * a12 + 4 * a66) * c * s).min() > 0


def test_bundled_vae_samples_are_what_they_always_were():
    """Datasets are named by their seeds: the same prior must go on giving the same fabrics."""
    theta = load_prior("vae").sample(2, np.random.default_rng(0))
    np.testing.assert_allclose(theta, BUNDLED_SAMPLES, rtol=1e-9)


def test_reading_and_sampling_need_neither_torch_nor_scikit_learn():
    code = ("import sys, numpy; from data.fabrics.prior import load_prior; "
            "load_prior('vae').sample(1, numpy.random.default_rng(0)); "
            "print(*({'torch', 'sklearn'} & set(sys.modules)))")
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True,
                            check=True, cwd=Path(__file__).parents[2])
    assert result.stdout.split() == []


@needs_table
@pytest.mark.slow
def test_bundled_vae_is_the_fit_of_the_published_table():
    fitted = MODELS["vae4"](read_fabric_table(TABLE).theta)
    bundled = load_prior("vae")
    assert fitted.fabrics == bundled.fabrics == 201
    theta = bundled.sample(200, np.random.default_rng(0))
    # Another machine's sums may send training elsewhere, but not to another distribution.
    assert abs((fitted.log_likelihood(theta) - bundled.log_likelihood(theta)).mean()) < 0.1
