import json
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from common.errors import InputError
from data.fabrics.fabrics import TABLE_COLUMNS, from_theta, read_fabric_table
from data.fabrics.prior import MODELS, GaussianPrior, load_prior, sample_admissible, save_prior
from data.fabrics.prior.__main__ import main
from data.fabrics.prior.table import TablePrior
from sim.material import is_admissible

TABLE = Path(__file__).parents[2] / ".." / "shared" / "fabrics" / "feng2022_train.csv"
needs_table = pytest.mark.skipif(not TABLE.exists(), reason="the fabric table is not here")


@pytest.fixture
def prior():
    return load_prior("gaussian")


def test_bundled_prior_describes_real_fabrics(prior):
    alpha, _ = from_theta(prior.mean)
    assert prior.fabrics == 201
    assert (alpha > 10e-6).all() and (alpha < 30e-6).all()
    ratio = prior.sample(4000, np.random.default_rng(0))[:, 3:]
    # Nearly all fabrics soften, by a beta/alpha of a few millimetres.
    assert (ratio < 0).mean() > 0.96
    assert (np.abs(np.median(ratio, axis=0) + 2.65e-3) < 0.2e-3).all()


def test_samples_have_the_mean_and_covariance(prior):
    theta = prior.sample(40_000, np.random.default_rng(1))
    deviation = np.sqrt(np.diag(prior.covariance))
    assert (np.abs(theta.mean(axis=0) - prior.mean) < 0.03 * deviation).all()
    scale = np.outer(deviation, deviation)
    assert np.abs((np.cov(theta.T) - prior.covariance) / scale).max() < 0.03


def test_samples_are_reproducible_and_extend(prior):
    long = prior.sample(5, np.random.default_rng(3))
    np.testing.assert_array_equal(long[:2], prior.sample(2, np.random.default_rng(3)))


def test_log_likelihood_is_the_normal_density(prior):
    theta = prior.sample(7, np.random.default_rng(2))
    expected = multivariate_normal(prior.mean, prior.covariance).logpdf(theta)
    np.testing.assert_allclose(prior.log_likelihood(theta), expected, rtol=1e-9)


def test_fit_recovers_a_gaussian_and_shrugs_off_an_outlier(prior):
    theta = prior.sample(3000, np.random.default_rng(4))
    clean = GaussianPrior.fit(theta)
    theta[0, 3] = 0.5  # half a metre: a broken measurement
    spoilt = GaussianPrior.fit(theta)
    deviation = np.sqrt(np.diag(prior.covariance))
    for fitted in (clean, spoilt):
        assert (np.abs(fitted.mean - prior.mean) < 0.08 * deviation).all()
        ratio = np.sqrt(np.diag(fitted.covariance)) / deviation
        assert (ratio > 0.9).all() and (ratio < 1.05).all()


def test_fit_needs_more_fabrics_than_parameters(prior):
    with pytest.raises(InputError, match="at least 7"):
        GaussianPrior.fit(prior.mean[None].repeat(6, axis=0))


@pytest.mark.parametrize("spoil", [
    lambda theta: theta * [1, 1, 1, 0, 0, 0],  # beta = 0
    lambda theta: theta[:, [0, 1, 0, 3, 4, 3]],  # alike along warp and weft
    lambda theta: np.column_stack([theta[:, :5], -2e-3 * (1 + 1e-16 * theta[:, 0])]),
])
def test_fit_refuses_fabrics_that_do_not_differ_in_everything(prior, spoil):
    theta = spoil(prior.sample(30, np.random.default_rng(5)))
    with pytest.raises(InputError, match=r"fabrics of the table do not differ .* beta_over_alpha"):
        GaussianPrior.fit(theta)


def test_save_and_load(prior, tmp_path):
    save_prior(prior, tmp_path / "deep" / "p.json")
    loaded = load_prior(tmp_path / "deep" / "p.json")
    np.testing.assert_array_equal(loaded.mean, prior.mean)
    np.testing.assert_array_equal(loaded.covariance, prior.covariance)
    assert [p.name for p in (tmp_path / "deep").iterdir()] == ["p.json"]


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"kind": "oracle"}, "kind"),
        ({"kind": ["gaussian"]}, "kind"),
        ({"schema_version": 99}, "schema version"),
        ({"parameters": ["a"]}, "other parameters"),
        ({"mean": [0, 1]}, "mean: give 6 finite"),
        ({"mean": None}, "mean: give 6 finite"),
        ({"mean": "many"}, "mean: give 6 finite"),
        ({"fabrics": float("inf")}, "not a JSON document"),
        ({"fabrics": 201.5}, "fabrics: .* integer"),
        ({"covariance": np.diag([1, 1, 1, 1, 1, -1]).tolist()}, "positive definite"),
        ({"covariance": (np.eye(6) + np.eye(6, k=1)).tolist()}, "symmetric"),
        ({"covariance": (np.eye(6) * np.nan).tolist()}, "not a JSON document"),
    ],
)
def test_bad_priors_are_refused_in_one_line(prior, tmp_path, change, complaint):
    path = tmp_path / "p.json"
    save_prior(prior, path)
    path.write_text(json.dumps(json.loads(path.read_text()) | change))
    with pytest.raises(InputError, match=complaint) as refusal:
        load_prior(path)
    assert "\n" not in str(refusal.value) and str(path) in str(refusal.value)


def test_a_table_of_fabrics_is_a_prior(prior, tmp_path):
    table = TablePrior(prior.sample(3, np.random.default_rng(0)))
    save_prior(table, tmp_path / "table.json")
    np.testing.assert_array_equal(load_prior(tmp_path / "table.json").theta, table.theta)
    file = tmp_path / "table.json"
    file.write_text(json.dumps(json.loads(file.read_text()) | {"theta": [[0.0] * 5]}))
    with pytest.raises(InputError, match="theta: give K × 6 finite numbers"):
        load_prior(file)


@pytest.mark.parametrize("text", ["", "[]", "3", "{", "[" * 100_000])
def test_other_files_are_not_a_prior(tmp_path, text):
    path = tmp_path / "p.json"
    path.write_text(text)
    with pytest.raises(InputError, match=r"not a prior|not a JSON document"):
        load_prior(path)


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
    monkeypatch.setattr("data.fabrics.prior.MAX_TRIES", 5)
    with pytest.raises(InputError, match="possible fabric"):
        sample_admissible(Reluctant(5), np.random.default_rng(0))


def test_a_prior_that_cannot_be_sampled_replaces_none(tmp_path, monkeypatch):
    table, out = tmp_path / "t.csv", tmp_path / "p.json"
    table.write_text(", ".join(f"{name}[{unit}]" for name, unit in TABLE_COLUMNS.items())
                     + "\n0.15, 9000, 4000, 6000, -900, -400, -600")
    out.write_text("a good one")
    monkeypatch.setattr("data.fabrics.prior.MAX_TRIES", 5)
    monkeypatch.setitem(MODELS, "gaussian", lambda theta: Reluctant(5))
    with pytest.raises(InputError, match="possible fabric"):
        main(["fit", f"fabrics={table}", f"out={out}", "model=gaussian"])
    assert out.read_text() == "a good one"


@needs_table
def test_bundled_prior_is_the_fit_of_the_published_table(prior, tmp_path, capsys):
    main(["fit", f"fabrics={TABLE}", f"out={tmp_path / 'p.json'}", "model=gaussian"])
    fitted = load_prior(tmp_path / "p.json")
    np.testing.assert_allclose(fitted.mean, prior.mean, rtol=1e-9)
    np.testing.assert_allclose(fitted.covariance, prior.covariance, rtol=1e-9)
    assert "201 distinct fabrics" in capsys.readouterr().out


@needs_table
def test_bundled_prior_covers_the_published_fabrics(prior):
    theta = read_fabric_table(TABLE).theta
    white = np.linalg.solve(np.linalg.cholesky(prior.covariance), (theta - prior.mean).T)
    distance = np.sqrt((white**2).sum(axis=0))
    # 99.9 % of a Gaussian in six dimensions lie within 4.7.
    assert (distance < 4.7).mean() > 0.95


@pytest.mark.parametrize(("words", "complaint"), [
    ([], "no command; the first word is one of: fit"),
    (["fitt"], "unknown command 'fitt', perhaps fit; the first word is one of: fit"),
    (["fit"], "fabrics= is missing; give a table"),
    (["fit", "fabrics=nowhere.csv"], "nowhere.csv cannot be read"),
    (["fit", "speed=1"], "unknown key 'speed'"),
    (["fit", "fabrics=nowhere.csv", "model=oracle"], "model=oracle"),
])
def test_command_line_mistakes(words, complaint):
    with pytest.raises(InputError, match=complaint):
        main(words)


@pytest.mark.parametrize("out", ["", "/proc/prior.json"])
def test_a_place_that_cannot_be_written_to_is_told_before_the_fit(out):
    with pytest.raises(InputError, match="cannot write"):
        main(["fit", "fabrics=nowhere.csv", f"out={out}"])
