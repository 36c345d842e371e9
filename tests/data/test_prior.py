"""Priors of fabrics: samples, fits, files and the command that fits one."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from common.errors import InputError
from data.fabrics.fabrics import TABLE_COLUMNS, from_theta
from data.fabrics.prior import (
    BUNDLED,
    MODELS,
    Architecture,
    Coordinates,
    GaussianPrior,
    TablePrior,
    VaePrior,
    load_prior,
    plausible_range,
    prior_content,
    prior_from_content,
    sample_admissible,
    save_prior,
)
from data.fabrics.prior.__main__ import main
from data.fabrics.prior.vae import SIGMA_MIDDLE, SIGMA_REACH
from sim.material import is_admissible, plate_constants, torque

TABLE = Path(__file__).parents[3] / "shared" / "fabrics" / "feng2022_train.csv"
needs_table = pytest.mark.skipif(not TABLE.exists(), reason="the fabric table is not here")
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
def vae(theta):
    return VaePrior.fit(theta, architecture=SMALL)


@pytest.fixture
def gaussian():
    return load_prior("gaussian")


def test_bundled_prior_describes_real_fabrics(gaussian):
    alpha, _ = from_theta(gaussian.mean)
    assert gaussian.fabrics == 201
    assert (alpha > 10e-6).all() and (alpha < 30e-6).all()
    ratio = gaussian.sample(4000, np.random.default_rng(0))[:, 3:]
    # Nearly all fabrics soften, by a beta/alpha of a few millimetres.
    assert (ratio < 0).mean() > 0.96
    assert (np.abs(np.median(ratio, axis=0) + 2.65e-3) < 0.2e-3).all()


def test_samples_have_the_mean_and_covariance(gaussian):
    theta = gaussian.sample(40_000, np.random.default_rng(1))
    deviation = np.sqrt(np.diag(gaussian.covariance))
    assert (np.abs(theta.mean(axis=0) - gaussian.mean) < 0.03 * deviation).all()
    scale = np.outer(deviation, deviation)
    assert np.abs((np.cov(theta.T) - gaussian.covariance) / scale).max() < 0.03


def test_fit_recovers_a_gaussian_and_shrugs_off_an_outlier(gaussian):
    theta = gaussian.sample(3000, np.random.default_rng(4))
    clean = GaussianPrior.fit(theta)
    theta[0, 3] = 0.5  # half a metre: a broken measurement
    spoilt = GaussianPrior.fit(theta)
    deviation = np.sqrt(np.diag(gaussian.covariance))
    for fitted in (clean, spoilt):
        assert (np.abs(fitted.mean - gaussian.mean) < 0.08 * deviation).all()
        ratio = np.sqrt(np.diag(fitted.covariance)) / deviation
        assert (ratio > 0.9).all() and (ratio < 1.05).all()


@pytest.mark.parametrize("spoil", [
    lambda theta: theta * [1, 1, 1, 0, 0, 0],  # beta = 0
    lambda theta: theta[:, [0, 1, 0, 3, 4, 3]],  # alike along warp and weft
    lambda theta: np.column_stack([theta[:, :5], -2e-3 * (1 + 1e-16 * theta[:, 0])]),
])
def test_fit_refuses_fabrics_that_do_not_differ_in_everything(gaussian, spoil):
    theta = spoil(gaussian.sample(30, np.random.default_rng(5)))
    with pytest.raises(InputError, match=r"fabrics of the table do not differ .* beta_over_alpha"):
        GaussianPrior.fit(theta)


def test_an_outlier_is_clipped_and_clipping_twice_changes_nothing(theta):
    low, high = plausible_range(theta)
    assert high[3] < 0.01 < theta[7, 3]
    drawn = np.clip(theta, low, high)
    assert (drawn != theta).sum() < 5
    np.testing.assert_allclose(plausible_range(drawn), (low, high), rtol=1e-9)


def test_samples_of_a_vae_are_its_model_and_widening_widens_its_latents(theta):
    """Its decoder is linear, so that its fabrics are normally distributed."""
    coordinates, rng = Coordinates.fit(theta)[0], np.random.default_rng(3)
    mixing, sigma = rng.normal(0, 0.8, (6, 2)), rng.uniform(0.4, 0.8, 6)
    output = np.arctanh((np.log(sigma) - SIGMA_MIDDLE) / SIGMA_REACH)
    weights = {"encoder.0.weight": np.zeros((4, 6)), "encoder.0.bias": np.zeros(4),
               "decoder.0.weight": np.vstack([mixing, np.zeros((6, 2))]),
               "decoder.0.bias": np.concatenate([np.zeros(6), output])}
    prior = VaePrior(coordinates=coordinates, fabrics=100, shift=0.0, spread=(1.0, 1.0), weights={
        name: array.astype(np.float32) for name, array in weights.items()})
    covariance = mixing @ mixing.T + np.diag(sigma**2)
    # Variance of the mean, 1/12; mean of the squared deviation, 1 + 0.4²/12.
    widened_covariance = covariance + (1 / 12 + 0.4**2 / 12) * mixing @ mixing.T
    widened = replace(prior, shift=0.5, spread=(0.8, 1.2))
    for model, expected in ((prior, covariance), (widened, widened_covariance)):
        points = coordinates.encode(model.sample(20_000, np.random.default_rng(6)))
        deviation = np.sqrt(np.diag(expected))
        difference = (np.cov(points.T) - expected) / np.outer(deviation, deviation)
        assert np.abs(difference).max() < 0.03  # three standard errors; widening adds 0.09


def test_samples_extend_and_training_repeats(theta, vae, gaussian):
    rng = np.random.default_rng(3)
    one_by_one = np.vstack([vae.sample(1, rng) for _ in range(6)])
    np.testing.assert_array_equal(vae.sample(6, np.random.default_rng(3)), one_by_one)
    np.testing.assert_array_equal(gaussian.sample(5, np.random.default_rng(3))[:2],
                                  gaussian.sample(2, np.random.default_rng(3)))
    zero, negative = (prior_from_content(prior_content(vae) | {"shift": shift}, origin="p.json")
                      for shift in (0.0, -0.0))
    np.testing.assert_array_equal(*(one.sample(3, np.random.default_rng(1))
                                    for one in (zero, negative)))
    assert prior_content(VaePrior.fit(theta, architecture=SMALL)) == prior_content(vae)
    assert prior_content(VaePrior.fit(theta, architecture=SMALL, seed=1)) != prior_content(vae)


def test_files_are_read_back_bit_by_bit(gaussian, vae, theta, tmp_path):
    for prior in (gaussian, vae, TablePrior(theta)):
        save_prior(prior, tmp_path / "deep" / "p.json")
        again = load_prior(tmp_path / "deep" / "p.json")
        assert prior_content(again) == prior_content(prior)
        np.testing.assert_array_equal(again.sample(5, np.random.default_rng(1)),
                                      prior.sample(5, np.random.default_rng(1)))
        assert [p.name for p in (tmp_path / "deep").iterdir()] == ["p.json"]


def test_too_few_or_equal_fabrics_are_refused(theta):
    for model, least in (("gaussian", 7), ("vae4", 20)):
        with pytest.raises(InputError, match=f"at least {least}"):
            MODELS[model](theta[: least - 1])
    for shared in (21, 40):
        fabrics = theta[:40].copy()
        fabrics[:shared, 3] = -2e-3 * (1 + 1e-16 * np.arange(shared))  # equal but for rounding
        with pytest.raises(InputError, match=r"more than half .* beta_over_alpha_warp"):
            MODELS["vae4"](fabrics)


class Reluctant:
    """Draws ``impossible`` fabrics without twisting stiffness before a possible one."""

    def __init__(self, impossible):
        self.left = impossible

    def sample(self, n, rng):
        self.left -= 1
        bias = 1e-9 if self.left >= 0 else 20e-6
        return np.log([[80e-6, bias, 5e-6, 1, 1, 1]]) * [1, 1, 1, 0, 0, 0]


def test_impossible_fabrics_are_rejected_and_counted(monkeypatch):
    theta, rejected = sample_admissible(Reluctant(3), np.random.default_rng(0))
    assert rejected == 3
    assert is_admissible(*from_theta(theta))
    monkeypatch.setattr("data.fabrics.prior.base.MAX_TRIES", 5)
    with pytest.raises(InputError, match="possible fabric"):
        sample_admissible(Reluctant(5), np.random.default_rng(0))


def test_a_prior_that_cannot_be_sampled_replaces_none(tmp_path, monkeypatch):
    table, out = tmp_path / "t.csv", tmp_path / "p.json"
    table.write_text(", ".join(TABLE_COLUMNS)
                     + "\n0.15, 9000, 4000, 6000, -900, -400, -600")
    out.write_text("a good one")
    monkeypatch.setattr("data.fabrics.prior.base.MAX_TRIES", 5)
    monkeypatch.setitem(MODELS, "gaussian", lambda theta: Reluctant(5))
    with pytest.raises(InputError, match="possible fabric"):
        main(["fit", f"fabrics={table}", f"out={out}", "model=gaussian"])
    assert out.read_text() == "a good one"


@pytest.mark.parametrize("name", BUNDLED)
def test_fabrics_of_the_bundled_priors_resist_bending_in_every_direction(name):
    prior, rng = load_prior(name), np.random.default_rng(8)
    curvature = np.linspace(1, 500, 200)  # 1/m; drapes visit some 300
    angle = np.linspace(0, np.pi / 2, 61)
    draws = [sample_admissible(prior, rng) for _ in range(100)]
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
def test_bundled_prior_is_the_fit_of_the_published_table(gaussian, tmp_path, capsys):
    main(["fit", f"fabrics={TABLE}", f"out={tmp_path / 'p.json'}", "model=gaussian"])
    fitted = load_prior(tmp_path / "p.json")
    np.testing.assert_allclose(fitted.mean, gaussian.mean, rtol=1e-9)
    np.testing.assert_allclose(fitted.covariance, gaussian.covariance, rtol=1e-9)
    assert "201 distinct fabrics" in capsys.readouterr().out
