"""Priors of fabrics: distributions over theta, fitted to measured fabrics.

A prior is a JSON file; its "kind" selects the class. Those in ``data/weights`` were fitted to the
distinct fabrics published with Feng et al. 2022; to fit one to another table:
``python -m data.fabrics.prior fit fabrics=FILE out=prior.json``.
"""

import base64
import math
from collections.abc import Callable
from dataclasses import dataclass, field, fields
from functools import cached_property, partial
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import numpy as np
from pydantic import AfterValidator, Field, PlainValidator, TypeAdapter, ValidationError
from safetensors import SafetensorError
from safetensors.numpy import load, save

from common.documents import read_json
from common.errors import InputError, one_line, shown
from common.files import replace_json
from common.types import Theta
from data.fabrics.fabrics import THETA_NAMES, from_theta
from sim.material import LINEAR, RATIO, is_admissible

if TYPE_CHECKING:
    import torch

SCHEMA_VERSION = 1
WEIGHTS = Path(__file__).resolve().parents[2] / "weights"
BUNDLED = ("gaussian", "vae")
"""Names of the priors that ship with the project, ``data/weights/NAME.json``."""
MAX_TRIES = 10_000
_FIT_SAMPLES = 20_000  # samples from which the prior's softening is estimated
_LEAST_RATIO = 1e-6  # m, of mean |beta|/alpha, for its logarithm
_ROUNDING = 1e-14  # of the largest variance; smaller eigenvalues are rounding errors


def log_stiffness(theta: Theta) -> np.ndarray:
    """Mean of the three log alphas of each fabric, (...)."""
    return theta[..., LINEAR].mean(axis=-1)


class Stored:
    """Base of dataclasses in JSON; annotations of fields validate them, see :func:`array`."""

    def as_dict(self) -> dict:
        """All parameters, in JSON types."""
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        return {name: value.as_dict() if isinstance(value, Stored) else np.asarray(value).tolist()
                for name, value in values.items()}


class Prior(Stored):
    """A distribution over theta (see :mod:`data.fabrics.fabrics`)."""

    kind: ClassVar[str]

    def sample(self, n: int, rng: np.random.Generator) -> Theta:
        """Draw n fabrics, admissible or not."""
        raise NotImplementedError

    @cached_property
    def softening(self) -> float:
        """Exponent p of beta/alpha ~ alpha^p across fabrics: slope of a straight line through the
        logarithm of the mean |beta|/alpha over the mean log alpha. In the published table, and in
        the bundled autoencoder, it is 0.25."""
        samples = self.sample(_FIT_SAMPLES, np.random.default_rng(0))
        ratio = np.maximum(np.abs(samples[:, RATIO]).mean(axis=1), _LEAST_RATIO)
        (variance, covariance), _ = np.cov(log_stiffness(samples), np.log(ratio))
        return float(covariance / max(variance, _TOLERANCE))


Count = Annotated[int, Field(ge=0, strict=True)]


def array(*shape: int | None) -> Any:
    """Type of a field of finite numbers with a given shape, None for any length but 0."""
    return Annotated[np.ndarray, PlainValidator(partial(_finite, shape))]


def _finite(shape: tuple[int | None, ...], content: object) -> np.ndarray:
    try:
        numbers = np.array(content, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        numbers = np.array(np.nan)
    if (numbers.ndim != len(shape) or not numbers.size or not np.isfinite(numbers).all()
            or any(size not in (None, length) for size, length in
                   zip(shape, numbers.shape, strict=True))):
        raise ValueError(f"give {' × '.join(str(size or 'K') for size in shape)} finite numbers")
    return numbers


def _definite(covariance: np.ndarray) -> bool:
    """Whether a matrix is symmetric and, beyond rounding errors, positive definite."""
    variances = np.linalg.eigvalsh(covariance)
    return np.allclose(covariance, covariance.T) and variances[0] > _ROUNDING * variances[-1]


def _covariance(covariance: np.ndarray) -> np.ndarray:
    if not _definite(covariance):
        raise ValueError("the covariance must be symmetric and positive definite")
    return covariance


def require_fabrics(theta: Theta, least: int) -> None:
    """InputError for fewer than ``least`` fabrics."""
    if len(theta) < least:
        raise InputError(
            f"the table has {len(theta)} distinct fabrics; a prior needs at least {least}")


@dataclass(frozen=True, eq=False)
class GaussianPrior(Prior):
    """A normal distribution of theta, fitted to a number of ``fabrics``."""

    mean: array(6)
    covariance: Annotated[array(6, 6), AfterValidator(_covariance)]
    fabrics: Count
    kind: ClassVar[str] = "gaussian"

    TAIL: ClassVar[float] = 0.01
    """Share of the fabrics at each end of each parameter that is clipped to that quantile before
    fitting. Cantilever tests of very limp cloth give a few outliers of beta/alpha (one of +40 mm
    among 201, all others between -17 and +1), which would otherwise triple the standard deviation
    along the warp and make one fabric in ten stiffen when bent instead of one in a hundred."""

    @property
    def deviation(self) -> np.ndarray:
        """(6,) standard deviation of each component of theta."""
        return np.sqrt(np.diag(self.covariance))

    @classmethod
    def fit(cls, theta: Theta) -> "GaussianPrior":
        """Fit to distinct fabrics, more than six, with tails clipped at ``TAIL``."""
        require_fabrics(theta, 7)
        low, high = np.quantile(theta, [cls.TAIL, 1 - cls.TAIL], axis=0)
        clipped = np.clip(theta, low, high)
        covariance = np.cov(clipped.T)
        if not _definite(covariance):
            raise InputError("the fabrics of the table do not differ in six numbers "
                             f"({', '.join(THETA_NAMES)}) independent of each other, as "
                             "model=gaussian needs; measure more, or other ones")
        return cls(clipped.mean(axis=0), covariance, len(theta))

    def sample(self, n: int, rng: np.random.Generator) -> Theta:
        # Explicit factor: the factorisation in numpy's multivariate_normal may change.
        factor = np.linalg.cholesky(self.covariance)
        return self.mean + rng.standard_normal((n, 6)) @ factor.T


BEND = 2e-3
"""beta/alpha, m, at which arcsinh changes from linear to logarithmic."""

MAX_DEVIATIONS = 4.0
"""Robust standard deviations (1.48 times the median absolute deviation) beyond which a measurement
is clipped: one of +40 mm and one of -17 mm among the 603 ratios of the published table."""

_TOLERANCE = 1e-9
"""Coordinates that differ by less are equal up to rounding."""


def _compress(theta: Theta) -> np.ndarray:
    return np.concatenate([theta[..., :3], np.arcsinh(theta[..., 3:] / BEND)], axis=-1)


def _expand(folded: np.ndarray) -> Theta:
    return np.concatenate([folded[..., :3], BEND * np.sinh(folded[..., 3:])], axis=-1)


def plausible_range(theta: Theta) -> tuple[Theta, Theta]:
    """Bounds ``MAX_DEVIATIONS`` from the medians of fabrics, which clipping does not change."""
    folded = _compress(theta)
    middle = np.median(folded, axis=0)
    reach = MAX_DEVIATIONS * (1.4826 * np.median(np.abs(folded - middle), axis=0))
    return _expand(middle - reach), _expand(middle + reach)


def _positive(scale: np.ndarray) -> np.ndarray:
    if not (scale > 0).all():
        raise ValueError("scales must be positive")
    return scale


@dataclass(frozen=True, eq=False)
class Coordinates(Stored):
    """Map between theta and the standardised coordinates (..., 6) of an autoencoder: log alpha, and
    arcsinh of beta/alpha over ``BEND``, less ``mean`` (6,), over ``scale`` (6,).

    Bending ratios beta/alpha have a long tail (median -2.4 mm, lowest -17 mm), which arcsinh
    compresses smoothly across the sign of beta, and a few outliers, which are clipped before
    fitting.
    """

    mean: array(6)
    scale: Annotated[array(6), AfterValidator(_positive)]

    def as_dict(self) -> dict:
        """All parameters, in JSON types, and the constant :data:`BEND`."""
        return {"bend": BEND} | super().as_dict()

    @classmethod
    def fit(cls, theta: Theta) -> tuple["Coordinates", np.ndarray]:
        """Fit to fabrics; return also their coordinates, with outliers clipped."""
        folded = _compress(np.clip(theta, *plausible_range(theta)))
        shared = np.flatnonzero(np.ptp(folded, axis=0) < _TOLERANCE)
        if len(shared):
            raise InputError(f"more than half of the fabrics have the same {THETA_NAMES[shared[0]]}"
                             "; a prior needs fabrics that differ")
        coordinates = cls(mean=folded.mean(axis=0), scale=folded.std(axis=0))
        return coordinates, (folded - coordinates.mean) / coordinates.scale

    def encode(self, theta: Theta) -> np.ndarray:
        """Coordinates of theta, without clipping."""
        return (_compress(np.asarray(theta, dtype=np.float64)) - self.mean) / self.scale

    def decode(self, coordinates: np.ndarray) -> Theta:
        """Theta of coordinates."""
        return _expand(self.mean + self.scale * coordinates)


BATCH = 16  # fabrics per step, as in the paper
WEIGHT_DECAY = 1e-5  # as in the paper
DRAWS = 8
WARM_UP = 0.25  # share of the steps in which the weight of log p(z) / q(z | fabric) rises to 1

DECIMALS = 12
"""Decimals to which samples are rounded, so that they nearly always agree between machines whose
libraries differ in the last bits."""


@dataclass(frozen=True)
class Architecture:
    """Layer sizes and training schedule of an autoencoder."""

    hidden: tuple[int, ...]  # units of the encoder's layers; the decoder has the reverse order
    latent: int  # number of latent variables
    steps: int = 2000
    learning_rate: float = 2e-3


ARCHITECTURES = {
    "vae1": Architecture((2048, 1024, 512, 128), 64, steps=600, learning_rate=5e-4),
    "vae2": Architecture((512, 256, 128, 32), 32, steps=1500, learning_rate=1e-3),
    "vae3": Architecture((128, 32, 16), 8),
    "vae4": Architecture((32, 16, 8), 4),
}
"""VAE-1 to VAE-4 of Table 1."""

SIGMA_MIDDLE, SIGMA_REACH = -1.0, 1.5
"""The log of sigma is middle + reach * tanh(output), so that sigma, relative to the standard
deviation of the table, is between 0.08 and 1.65. This prevents overfitting and distant samples."""

Layers = list[tuple[np.ndarray, np.ndarray]]


def _layers(weights: dict[str, np.ndarray], name: str) -> Layers:
    count = sum(key.startswith(f"{name}.") for key in weights) // 2
    return [tuple(weights[f"{name}.{k}.{part}"].astype(np.float64) for part in ("weight", "bias"))
            for k in range(count)]


def run_layers(layers: Layers, values: np.ndarray) -> np.ndarray:
    """Output (..., out) of the layers for values (..., in), with tanh between them."""
    for weight, bias in layers[:-1]:
        values = np.tanh(values @ weight.T + bias)
    weight, bias = layers[-1]
    return values @ weight.T + bias


def _decoded(content: object) -> dict[str, np.ndarray]:
    """Weights of an encoder and a decoder of matching sizes, from base64 of a safetensors file."""
    try:
        weights = load(base64.b64decode(content, validate=True))
    except (TypeError, ValueError, SafetensorError):
        raise ValueError("must be base64 of a safetensors file") from None
    if not all(values.dtype == np.float32 and np.isfinite(values).all()
               for values in weights.values()):
        raise ValueError("give finite numbers of type float32")
    try:
        encoder, decoder = (_layers(weights, name) for name in ("encoder", "decoder"))
        latent = len(run_layers(encoder, np.zeros(6))) // 2
        fits = run_layers(decoder, np.zeros(latent)).shape == (12,)
    except (IndexError, KeyError, ValueError):
        fits = False
    if not fits or len(weights) != 2 * (len(encoder) + len(decoder)):
        raise ValueError("must be those of an encoder and a decoder of 6 numbers")
    return weights


def _spread(spread: np.ndarray) -> np.ndarray:
    if not 0 < spread[0] <= spread[1]:
        raise ValueError("give two positive numbers in order")
    return spread


@dataclass(frozen=True, kw_only=True, eq=False)
class VaePrior(Prior):
    """A variational autoencoder (Feng et al. 2022, section 5.1.3, Table 1).

    Latent variables z ~ N(0, 1); the six coordinates of a fabric ~ N(mean, sigma²), independent,
    where the decoder gives mean and sigma for z. The encoder's normal distribution q(z | fabric)
    serves training. All but the training is NumPy in float64.

    Attributes:
        shift, spread: each latent variable of a sample has a mean from [-shift, shift] and a
            standard deviation from the range ``spread`` (section 5.1.3, last paragraph), so that
            samples extend beyond the ``fabrics`` it was fitted to.
        weights: "encoder.K.weight" (out, in) and "encoder.K.bias" (out,) of its layers K = 0, 1,
            ..., which end in the mean and the log variance of z (2 L); the same for "decoder",
            which ends in means and sigmas (12).
    """

    coordinates: Coordinates
    shift: Annotated[float, Field(ge=0, le=1e6, strict=True)] = 0.5
    spread: Annotated[array(2), AfterValidator(_spread)] = (0.8, 1.2)
    fabrics: Count
    weights: Annotated[dict[str, np.ndarray], PlainValidator(_decoded)] = field(repr=False)
    kind: ClassVar[str] = "vae"

    @classmethod
    def fit(cls, theta: Theta, *, architecture: Architecture = ARCHITECTURES["vae4"],
            seed: int = 0) -> "VaePrior":
        """Train on distinct fabrics."""
        require_fabrics(theta, 20)
        coordinates, points = Coordinates.fit(theta)
        return cls(coordinates=coordinates, fabrics=len(theta),
                   weights=train(points, architecture, seed))

    @cached_property
    def encoder(self) -> Layers:
        """Weight and bias of each layer."""
        return _layers(self.weights, "encoder")

    @cached_property
    def decoder(self) -> Layers:
        """Weight and bias of each layer."""
        return _layers(self.weights, "decoder")

    @property
    def latent(self) -> int:
        """Number of latent variables."""
        return self.decoder[0][0].shape[1]

    def sample(self, n: int, rng: np.random.Generator) -> Theta:
        points = np.empty((n, 6))
        for point in points:  # one by one, so that the first samples do not depend on n
            # abs: NumPy refuses the range from 0.0 to -0.0.
            mean = rng.uniform(-abs(self.shift), abs(self.shift), self.latent)
            z = mean + rng.uniform(*self.spread, self.latent) * rng.standard_normal(self.latent)
            middle, log_sigma = self.likelihood(z)
            point[:] = middle + np.exp(log_sigma) * rng.standard_normal(6)
        return np.round(self.coordinates.decode(points), DECIMALS)

    def likelihood(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Mean and log sigma of the coordinates (..., 6) for latent variables (..., L)."""
        middle, output = np.split(run_layers(self.decoder, z), 2, axis=-1)
        return middle, SIGMA_MIDDLE + SIGMA_REACH * np.tanh(output)

    def as_dict(self) -> dict:
        """All parameters, in JSON types; the weights as base64 of a safetensors file."""
        return super().as_dict() | {
            "weights": base64.b64encode(save(self.weights)).decode("ascii")}


@dataclass(frozen=True, eq=False)
class TablePrior(Prior):
    """Measured fabrics, equally probable, for the evaluation of estimators."""

    theta: array(None, 6)
    kind: ClassVar[str] = "table"

    def sample(self, n: int, rng: np.random.Generator) -> Theta:
        return self.theta[rng.integers(len(self.theta), size=n)]


KINDS = {kind.kind: kind for kind in (GaussianPrior, VaePrior, TablePrior)}

MODELS: dict[str, Callable[[Theta], Prior]] = {
    "gaussian": GaussianPrior.fit,
    **{name: partial(VaePrior.fit, architecture=architecture)
       for name, architecture in ARCHITECTURES.items()},
}
"""Functions that fit each model to distinct fabrics."""


def prior_content(prior: Prior) -> dict:
    """Content of a prior's JSON file."""
    return {
        "schema_version": SCHEMA_VERSION,
        "kind": prior.kind,
        "parameters": list(THETA_NAMES),
        "units": "alpha in N·m, beta/alpha in m, at 300 g/m²",
        **prior.as_dict(),
    }


def prior_from_content(content: object, *, origin: str) -> Prior:
    """The prior of a decoded JSON file; ``origin`` names the file in error messages."""
    kind = content.get("kind") if isinstance(content, dict) else None
    if not isinstance(kind, str) or kind not in KINDS:
        raise InputError(f"{origin} is not a prior; its \"kind\" must be one of {', '.join(KINDS)}")
    if content.get("schema_version") != SCHEMA_VERSION:
        raise InputError(f"{origin} has the schema version {shown(content.get('schema_version'))}; "
                         f"this program reads version {SCHEMA_VERSION}: fit it again")
    if content.get("parameters") != list(THETA_NAMES):
        raise InputError(f"{origin} describes other parameters than {', '.join(THETA_NAMES)}; fit "
                         "it again")
    try:
        return TypeAdapter(KINDS[kind]).validate_python(content)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        cause = first.get("ctx", {}).get("error", first["msg"])
        place = ".".join(map(str, first["loc"]))
        raise InputError(f"{origin}: {place}: {one_line(Exception(cause))}; fit it again") from None


def save_prior(prior: Prior, path: str | Path) -> None:
    """Write the prior's JSON file in one step; an existing file is replaced."""
    replace_json(Path(path), prior_content(prior))


def load_prior(name: str | Path) -> Prior:
    """Read a prior: one of :data:`BUNDLED` by name, or a file."""
    path = WEIGHTS / f"{name}.json" if name in BUNDLED else Path(name)
    remedy = f"give the file of a prior; the bundled ones are {', '.join(BUNDLED)}"
    return prior_from_content(read_json(path, remedy=remedy), origin=str(path))


def sample_admissible(prior: Prior, rng: np.random.Generator) -> tuple[Theta, int]:
    """An admissible fabric (:func:`sim.material.is_admissible`), and the number of rejected ones.
    """
    for rejected in range(MAX_TRIES):
        theta = prior.sample(1, rng)[0]
        if is_admissible(*from_theta(theta)):
            return theta, rejected
    raise InputError(f"none of {MAX_TRIES} samples of the prior is a possible fabric; fit it "
                     "to more fabrics")


def train(points: np.ndarray, architecture: Architecture, seed: int) -> dict[str, np.ndarray]:
    """Train an autoencoder (see :class:`VaePrior`) on points (F, 6); return its weights.

    Adam maximises the importance-weighted bound on the likelihood with ``DRAWS`` latent vectors per
    fabric (Burda, Grosse and Salakhutdinov 2016); with one, the usual bound, more latent variables
    collapse. The weight of the ratio of p(z) to q(z | fabric) rises from 0 to 1.
    """
    import torch  # imported late: reading and sampling do not need it

    threads = torch.get_num_threads()
    torch.set_num_threads(1)  # sums do not depend on the machine's number of cores
    try:
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            return _train(torch.tensor(points, dtype=torch.float32), architecture)
    finally:
        torch.set_num_threads(threads)


def _train(points: "torch.Tensor", architecture: Architecture) -> dict[str, np.ndarray]:
    import torch

    hidden, latent = architecture.hidden, architecture.latent
    encoder, decoder = (
        torch.nn.Sequential(*[part for sizes in pairwise(widths)
                              for part in (torch.nn.Linear(*sizes), torch.nn.Tanh())][:-1])
        for widths in ([6, *hidden, 2 * latent], [latent, *reversed(hidden), 12]))
    optimiser = torch.optim.Adam(
        [*encoder.parameters(), *decoder.parameters()], lr=architecture.learning_rate,
        weight_decay=WEIGHT_DECAY, fused=True)
    steps = architecture.steps
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, steps)
    for step in range(steps):
        batch = points[torch.randint(len(points), (BATCH,))]
        mean, log_variance = encoder(batch).chunk(2, dim=-1)
        draws = torch.randn(DRAWS, *mean.shape)
        z = mean + torch.exp(0.5 * log_variance) * draws
        middle, output = decoder(z).chunk(2, dim=-1)
        log_sigma = SIGMA_MIDDLE + SIGMA_REACH * torch.tanh(output)
        white = (batch - middle) * torch.exp(-log_sigma)
        log_ratio = 0.5 * (draws**2 - z**2 + log_variance).sum(dim=-1)
        weight = min(1.0, (step + 1) / math.ceil(WARM_UP * steps))
        terms = weight * log_ratio - (0.5 * white**2 + log_sigma).sum(dim=-1)
        loss = -torch.logsumexp(terms, dim=0).mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        schedule.step()
    weights = {}
    for name, network in (("encoder", encoder), ("decoder", decoder)):
        for k, layer in enumerate(network[::2]):
            weights |= {f"{name}.{k}.weight": layer.weight, f"{name}.{k}.bias": layer.bias}
    return {name: value.detach().numpy().copy() for name, value in weights.items()}
