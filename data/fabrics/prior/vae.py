"""A variational autoencoder of fabrics."""

import base64
from dataclasses import dataclass, field
from functools import cached_property
from typing import Annotated, Any, ClassVar

import numpy as np
from pydantic import AfterValidator, Field, PlainValidator
from safetensors import SafetensorError
from safetensors.numpy import load, save

from common.types import Theta
from data.fabrics.prior.base import DECIMALS, Count, Prior, array, require_fabrics
from data.fabrics.prior.coordinates import Coordinates
from data.fabrics.prior.training import (
    ARCHITECTURES,
    SIGMA_MIDDLE,
    SIGMA_REACH,
    Architecture,
    train,
)

Layers = list[tuple[np.ndarray, np.ndarray]]


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
