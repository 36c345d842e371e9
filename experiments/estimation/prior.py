"""Likelihood of unseen fabrics under each prior (paper's Table 1).

Mixtures (GMM) and autoencoders (VAE) are fitted to 80 % of the distinct fabrics and evaluated on
the others, for several random splits. For all models, outliers are clipped to the plausible range
of the fitted part (:func:`data.fabrics.prior.plausible_range`). Log-likelihoods are per
fabric, in nats, of densities in log alpha and in beta/alpha in mm; that of an autoencoder is an
importance-weighted bound.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial, singledispatch
from typing import ClassVar

import numpy as np
from scipy.special import logsumexp
from scipy.stats import multivariate_normal
from sklearn.mixture import GaussianMixture
from tqdm import tqdm

from common.errors import InputError
from data.fabrics.fabrics import FabricTable, read_fabric_table
from data.fabrics.prior import (
    BEND,
    MODELS,
    Coordinates,
    GaussianPrior,
    Prior,
    VaePrior,
    plausible_range,
    require_fabrics,
)
from data.fabrics.prior.vae import run_layers
from experiments.result import Config, Result

FITTED = 0.8  # share of the fabrics that is fitted, as in the paper
PER_MILLIMETRE = 3 * np.log(1e-3)  # log of the volume of (mm)³ in m³


ITERATIONS = 200  # of expectation maximisation, as in the paper
INITIALISATIONS = 5
VARIANCE_FLOOR = 0.05
"""Added to the variances of every component, relative to those of the table. With the library's
default of 1e-6, a component of thirty fabrics overfits: 0.2 nats less per unseen fabric."""
_CHUNK = 16  # fabrics whose likelihood is estimated at a time, to limit memory


@dataclass(frozen=True, eq=False)
class MixturePrior(Prior):
    """A mixture of K normal distributions of the coordinates (Feng et al. 2022, section 5.1.3)."""

    coordinates: Coordinates
    weights: np.ndarray
    means: np.ndarray
    covariances: np.ndarray
    kind: ClassVar[str] = "mixture"

    @classmethod
    def fit(cls, theta: np.ndarray, *, components: int = 3) -> "MixturePrior":
        """Fit ``components`` normal distributions to the distinct fabrics theta (F, 6)."""
        require_fabrics(theta, 7 * components)
        coordinates, points = Coordinates.fit(theta)
        fitted = GaussianMixture(components, max_iter=ITERATIONS, n_init=INITIALISATIONS,
                                 reg_covar=VARIANCE_FLOOR, random_state=0).fit(points)
        return cls(coordinates, fitted.weights_, fitted.means_, fitted.covariances_)

    def sample(self, n: int, rng: np.random.Generator) -> np.ndarray:
        """Draw theta (n, 6), admissible or not; one by one, so that the first samples do not depend
        on n.
        """
        factors, bounds = np.linalg.cholesky(self.covariances), np.cumsum(self.weights)[:-1]
        points = np.empty((n, 6))
        for point in points:
            component = np.searchsorted(bounds, rng.random(), side="right")
            point[:] = self.means[component] + factors[component] @ rng.standard_normal(6)
        return self.coordinates.decode(points)


FITS: dict[str, Callable[[np.ndarray], Prior]] = MODELS | {
    f"gmm{k}": partial(MixturePrior.fit, components=k) for k in range(3, 8)}
"""Functions that fit each model of Table 1 of Feng et al. 2022, and the Gaussian."""


@singledispatch
def log_likelihood(prior: Prior, theta: np.ndarray) -> np.ndarray:
    """Log density (n,) of theta (n, 6), per unit of theta."""
    raise NotImplementedError


@log_likelihood.register
def _(prior: GaussianPrior, theta: np.ndarray) -> np.ndarray:
    return np.atleast_1d(multivariate_normal(prior.mean, prior.covariance).logpdf(theta))


@log_likelihood.register
def _(prior: MixturePrior, theta: np.ndarray) -> np.ndarray:
    points = prior.coordinates.encode(theta)
    terms = [np.log(weight) + multivariate_normal(mean, covariance).logpdf(points)
             for weight, mean, covariance in zip(prior.weights, prior.means, prior.covariances,
                                                 strict=True)]
    return logsumexp(terms, axis=0) + log_volume(prior.coordinates, theta)


@log_likelihood.register
def _(prior: VaePrior, theta: np.ndarray, *, draws: int = 100) -> np.ndarray:
    """The logarithm of the mean of p(theta, z) / q(z | theta) over ``draws`` values of z: its
    expectation is below the true value and approaches it with their number. It is computed for
    z ~ N(0, 1), without the widening of samples.
    """
    points = prior.coordinates.encode(theta)
    rng = np.random.default_rng(0)
    chunks = [points[i:i + _CHUNK] for i in range(0, len(points), _CHUNK)]
    bound = [importance_bound(prior, chunk, rng.standard_normal((len(chunk), draws, prior.latent)))
             for chunk in chunks]
    return np.concatenate(bound) + log_volume(prior.coordinates, theta)


def importance_bound(prior: VaePrior, points: np.ndarray, noise: np.ndarray) -> np.ndarray:
    """The bound (n,) for coordinates (n, 6), from standard normal noise (n, draws, L)."""
    mean, log_variance = np.split(run_layers(prior.encoder, points), 2, axis=-1)
    z = mean[:, None] + np.exp(0.5 * log_variance)[:, None] * noise
    middle, log_sigma = prior.likelihood(z)
    # log p(z) - log q(z | fabric), the factors of 2 pi cancelled ...
    terms = 0.5 * (noise**2 - z**2).sum(axis=-1) + 0.5 * log_variance.sum(axis=-1)[:, None]
    # ... and log p(fabric | z).
    white = (points[:, None] - middle) * np.exp(-log_sigma)
    terms -= (0.5 * white**2 + log_sigma).sum(axis=-1)
    return logsumexp(terms, axis=1) - 3 * np.log(2 * np.pi) - np.log(noise.shape[1])


def log_volume(coordinates: Coordinates, theta: np.ndarray) -> np.ndarray:
    """Log determinant (...) of the Jacobian of coordinates with respect to theta (..., 6)."""
    slope = -0.5 * np.log(BEND**2 + theta[..., 3:] ** 2)
    return slope.sum(axis=-1) - np.log(coordinates.scale).sum()


@dataclass(frozen=True)
class Split:
    """theta (F, 6) of the fitted and the unseen fabrics."""

    fitted: np.ndarray
    unseen: np.ndarray

    def clipped(self) -> tuple[np.ndarray, np.ndarray]:
        """Both parts, with outliers clipped to the plausible range of the fitted part."""
        low, high = plausible_range(self.fitted)
        return np.clip(self.fitted, low, high), np.clip(self.unseen, low, high)


def split_rows(theta: np.ndarray, seed: int) -> Split:
    """Split the rows of theta (F, 6) at random."""
    order = np.random.default_rng(seed).permutation(len(theta))
    fitted = round(FITTED * len(theta))
    return Split(theta[order[:fitted]], theta[order[fitted:]])


def log_likelihoods(prior: Prior, split: Split) -> tuple[float, float]:
    """Mean log-likelihoods of the fitted and the unseen fabrics, nats, beta/alpha in mm."""
    return tuple(float(log_likelihood(prior, part).mean()) + PER_MILLIMETRE
                 for part in split.clipped())


def mean_and_error(runs: list[dict]) -> dict:
    """[mean, standard error over the splits] of each figure."""
    values = {name: np.array([run[name] for run in runs]) for name in runs[0]}
    error = {name: v.std(ddof=1) / np.sqrt(len(v)) if len(v) > 1 else 0.0
             for name, v in values.items()}
    return {name: [float(v.mean()), float(error[name])] for name, v in values.items()}


def evaluate(model: str, split: Split) -> dict[str, float]:
    """Fit a model and evaluate it."""
    fitted, unseen = log_likelihoods(FITS[model](split.fitted), split)
    return {"log_likelihood_fitted": fitted, "log_likelihood_unseen": unseen}


def compare(fabrics: FabricTable, models: list[str], splits: int) -> dict:
    """Evaluate all models on all splits; contents of the report."""
    theta = fabrics.theta
    parts = [split_rows(theta, seed) for seed in range(splits)]
    runs = {model: [evaluate(model, split) for split in parts]
            for model in tqdm(models, unit="model")}
    return {"fabrics": len(theta), "unseen": len(parts[0].unseen),
            "models": {model: mean_and_error(figures) for model, figures in runs.items()},
            "runs": {model: [run["log_likelihood_unseen"] for run in figures]
                     for model, figures in runs.items()}}


def run(config: Config) -> Result:
    """Compare the models."""
    if unknown := [name for name in config["models"] if name not in FITS]:
        raise InputError(f"models={','.join(unknown)}: known are {', '.join(FITS)}")
    if config["splits"] < 1:
        raise InputError(f"splits={config['splits']} must be at least 1")
    return Result(compare(read_fabric_table(config["fabrics"]), config["models"],
                          config["splits"]))
