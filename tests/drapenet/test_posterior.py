"""The mixture against scipy, and its samples against its density."""

import numpy as np
import pytest
import torch
from scipy.stats import multivariate_normal

from drapenet.network.mixture import Mixture, factor_of, outputs_of
from drapenet.network.posterior import LEVELS, covered, ranks


@pytest.fixture
def mixture() -> Mixture:
    generator = torch.Generator().manual_seed(3)
    outputs = torch.randn(2, outputs_of(components=3, targets=4), generator=generator)
    return Mixture.of_outputs(outputs.double(), components=3, targets=4)


def test_the_likelihood_is_that_of_the_gaussians(mixture):
    at = torch.full((2, 4), 0.3, dtype=torch.float64)
    found = mixture.log_likelihood(at)
    for n in range(2):
        shares = mixture.logits[n].softmax(dim=0).numpy()
        densities = []
        for mean, factor in zip(mixture.means[n], mixture.factors[n], strict=True):
            covariance = np.linalg.inv((factor @ factor.T).numpy())
            densities.append(multivariate_normal(mean.numpy(), covariance).pdf(at[n].numpy()))
        assert found[n].item() == pytest.approx(np.log(shares @ densities), abs=1e-9)


def test_samples_have_the_density_s_moments_and_their_intervals_hold(mixture):
    draws = mixture.posterior.sample(40_000, np.random.default_rng(0))
    for n in range(2):
        shares = mixture.logits[n].softmax(dim=0).numpy()
        means = mixture.means[n].numpy()
        mean = shares @ means
        inverse = [np.linalg.inv((f @ f.T).numpy()) for f in mixture.factors[n]]
        covariance = sum(share * (c + np.outer(m - mean, m - mean))
                         for share, c, m in zip(shares, inverse, means, strict=True))
        deviation = np.sqrt(np.diag(covariance))
        assert draws[:, n].mean(axis=0) == pytest.approx(mean, abs=0.03 * deviation.max())
        assert np.cov(draws[:, n].T) / np.outer(deviation, deviation) == pytest.approx(
            covariance / np.outer(deviation, deviation), abs=0.05)
    truth = mixture.posterior.sample(500, np.random.default_rng(1))[:, 0]
    places = ranks(draws[:4000, :1], truth)
    assert covered(places).mean(axis=1) == pytest.approx(LEVELS, abs=0.04)
    assert covered(0.5 + (places - 0.5) / 2)[1].mean() > 0.95  # intervals twice too wide


def test_the_factor_of_residuals_is_that_of_their_precision():
    rng = np.random.default_rng(0)
    mixing = np.array([[1.0, 0.0], [0.6, 0.3]])
    residuals = torch.from_numpy(rng.standard_normal((4000, 2)) @ mixing.T).float()
    covariance = torch.linalg.inv(factor_of(residuals) @ factor_of(residuals).T)
    assert covariance.numpy() == pytest.approx(mixing @ mixing.T, rel=0.05)
    few = factor_of(residuals[:1])  # one residual has variances, but no correlation
    variances = torch.linalg.inv(few @ few.T).diagonal()
    assert variances.numpy() == pytest.approx(residuals[0].square().numpy(), rel=1e-4)


def test_a_regressions_likelihood_in_training_is_its_square_error():
    means, targets = torch.tensor([[0.5, -1.0]]), torch.tensor([[0.0, 1.0]])
    found = Mixture.around(means, torch.eye(2)).log_likelihood(targets)
    assert found.item() == pytest.approx(-(0.25 + 4) / 2 - np.log(2 * np.pi))
    both = Mixture.joined([Mixture.around(means, torch.eye(2))] * 2)
    assert both.mean.tolist() == [[0.5, -1.0]] * 2
