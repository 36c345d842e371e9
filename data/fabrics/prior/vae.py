"""A variational autoencoder of fabrics, with its training, in standardised coordinates."""

import base64
import math
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import numpy as np
from pydantic import AfterValidator, Field, PlainValidator
from safetensors import SafetensorError
from safetensors.numpy import load, save

from common.errors import InputError
from common.types import Theta
from data.fabrics.fabrics import THETA_NAMES
from data.fabrics.prior.base import (
    DECIMALS,
    TOLERANCE,
    Count,
    Prior,
    Stored,
    array,
    require_fabrics,
)

if TYPE_CHECKING:
    import torch

BEND = 2e-3
"""beta/alpha, m, at which arcsinh changes from linear to logarithmic."""

MAX_DEVIATIONS = 4.0
"""Robust standard deviations (1.48 times the median absolute deviation) beyond which a measurement
is clipped: one of +40 mm and one of -17 mm among the 603 ratios of the published table."""
BATCH = 16  # fabrics per step, as in the paper
WEIGHT_DECAY = 1e-5  # as in the paper
DRAWS = 8
WARM_UP = 0.25  # share of the steps in which the weight of log p(z) / q(z | fabric) rises to 1
Layers = list[tuple[np.ndarray, np.ndarray]]


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

    Bending ratios beta/alpha have a long tail, which arcsinh compresses across the sign of beta.
    """

    mean: Annotated[np.ndarray, array(6)]
    scale: Annotated[np.ndarray, array(6), AfterValidator(_positive)]

    def as_dict(self) -> dict:
        """All parameters, in JSON types, and the constant :data:`BEND`."""
        return {"bend": BEND} | super().as_dict()

    @classmethod
    def fit(cls, theta: Theta) -> tuple["Coordinates", np.ndarray]:
        """Fit to fabrics; return also their coordinates, with outliers clipped."""
        folded = _compress(np.clip(theta, *plausible_range(theta)))
        shared = np.flatnonzero(np.ptp(folded, axis=0) < TOLERANCE)
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


def train(points: np.ndarray, architecture: Architecture, seed: int) -> dict[str, np.ndarray]:
    """Train an autoencoder on standardised points (F, 6); return its weights, as ``VaePrior`` has.

    Adam maximises the importance-weighted bound on the likelihood with ``DRAWS`` latent vectors per
    fabric (Burda, Grosse and Salakhutdinov 2016). The weight of the ratio of p(z) to q(z | fabric)
    rises from 0 to 1.
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
    weights: dict[str, Any] = {}
    for name, network in (("encoder", encoder), ("decoder", decoder)):
        for k, layer in enumerate(network[::2]):
            weights |= {f"{name}.{k}.weight": layer.weight, f"{name}.{k}.bias": layer.bias}
    return {name: value.detach().numpy().copy() for name, value in weights.items()}


def _layers(weights: dict[str, np.ndarray], name: str) -> Layers:
    count = sum(key.startswith(f"{name}.") for key in weights) // 2
    return [(weights[f"{name}.{k}.weight"].astype(np.float64),
             weights[f"{name}.{k}.bias"].astype(np.float64)) for k in range(count)]


def run_layers(layers: Layers, values: np.ndarray) -> np.ndarray:
    """Output (..., out) of the layers for values (..., in), with tanh between them."""
    for weight, bias in layers[:-1]:
        values = np.tanh(values @ weight.T + bias)
    weight, bias = layers[-1]
    return values @ weight.T + bias


def _decoded(content: Any) -> dict[str, np.ndarray]:
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
    spread: Annotated[np.ndarray, array(2), AfterValidator(_spread)] = field(
        default_factory=lambda: np.array([0.8, 1.2]))
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
            low, high = self.spread
            z = mean + rng.uniform(low, high, self.latent) * rng.standard_normal(self.latent)
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
