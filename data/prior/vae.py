"""A variational autoencoder as prior (Feng et al. 2022, section 5.1.3, Table 1).

The model: latent variables z ~ N(0, 1), the six coordinates of a fabric ~ N(mean, sigma²), one by
one, where the decoder gives mean and sigma for z. The encoder's normal distribution q(z | fabric)
serves training and the estimate of likelihoods. Everything here is NumPy in float64; PyTorch
trains only (:mod:`data.prior.training`).
"""

import base64
import binascii
from dataclasses import dataclass, field
from functools import cached_property
from typing import ClassVar

import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import load, save
from scipy.special import logsumexp

from common.errors import InputError
from data.prior.architecture import ARCHITECTURES, SIGMA_MIDDLE, SIGMA_REACH, Architecture
from data.prior.base import check_fabrics, read_array, read_count
from data.prior.coordinates import Coordinates

DECIMALS = 12
"""Samples are rounded to this many decimals, which nearly always hides the last bits in which the
libraries of two machines differ."""

CHUNK = 16  # fabrics whose likelihood is estimated at a time, for the sake of memory

Layers = list[tuple[np.ndarray, np.ndarray]]


@dataclass(frozen=True)
class VaePrior:
    """A trained autoencoder.

    Attributes:
        coordinates: in which it sees fabrics.
        weights: "encoder.K.weight" (out, in) and "encoder.K.bias" (out,) of its layers K = 0,
            1, ..., the last of which gives the mean and the log variance of z (2 L); the same for
            "decoder", which ends in means and sigmas (12). Float32. Between layers stands tanh.
        fabrics: number of fabrics it was fitted to.
        shift: every latent variable of a sample has a mean drawn from [-shift, shift] ...
        spread: ... and a standard deviation drawn from this range (section 5.1.3, last
            paragraph), so that samples reach beyond the measured fabrics.
    """

    coordinates: Coordinates
    weights: dict[str, np.ndarray] = field(repr=False)
    fabrics: int
    shift: float = 0.5
    spread: tuple[float, float] = (0.8, 1.2)
    kind: ClassVar[str] = "vae"

    @classmethod
    def fit(cls, theta: np.ndarray, *, architecture: Architecture = ARCHITECTURES["vae4"],
            **training: float) -> "VaePrior":
        """Train on the distinct fabrics theta (F, 6); ``training`` as in :func:`train`."""
        # Imported late: reading and sampling do without PyTorch.
        from data.prior.training import train

        theta = check_fabrics(theta, least=20)
        coordinates, points = Coordinates.fit(theta)
        return cls(coordinates, train(points, architecture, **training), len(theta))

    @cached_property
    def encoder(self) -> Layers:
        """Weight and bias of each layer, float64."""
        return _layers(self.weights, "encoder")

    @cached_property
    def decoder(self) -> Layers:
        """Weight and bias of each layer, float64."""
        return _layers(self.weights, "decoder")

    @property
    def latent(self) -> int:
        """Number of latent variables."""
        return self.decoder[0][0].shape[1]

    def sample(self, n: int, rng: np.random.Generator) -> np.ndarray:
        """Draw theta (n, 6), admissible or not, from the widened latent distribution."""
        points = np.empty((n, 6))
        for point in points:  # one by one, so that more samples begin with the same ones
            mean = rng.uniform(-self.shift, self.shift, self.latent)
            z = mean + rng.uniform(*self.spread, self.latent) * rng.standard_normal(self.latent)
            middle, log_sigma = self._likelihood(z)
            point[:] = middle + np.exp(log_sigma) * rng.standard_normal(6)
        return np.round(self.coordinates.decode(points), DECIMALS)

    def log_likelihood(
        self, theta: np.ndarray, *, draws: int = 100, seed: int = 0
    ) -> np.ndarray:
        """Log density (n,) of theta (n, 6), per unit of theta, as an importance-weighted bound.

        The logarithm of the mean of p(theta, z) / q(z | theta) over ``draws`` values of z: in
        expectation below the true value, and rising towards it with their number. It is of
        z ~ N(0, 1); the widening of :meth:`sample` is not part of it. ``seed`` fixes the draws.
        """
        theta = np.atleast_2d(theta)
        points = self.coordinates.encode(theta)
        rng = np.random.default_rng(seed)
        chunks = [points[i:i + CHUNK] for i in range(0, len(points), CHUNK)]
        bound = [self._bound(chunk, rng.standard_normal((len(chunk), draws, self.latent)))
                 for chunk in chunks]
        return np.concatenate(bound) + self.coordinates.log_volume(theta)

    def posterior(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Mean and deviation (n, L) of q(z | fabric) for ``points`` (n, 6), standardised."""
        mean, log_variance = np.split(run_layers(self.encoder, points), 2, axis=-1)
        return mean, np.exp(0.5 * log_variance)

    def _bound(self, points: np.ndarray, noise: np.ndarray) -> np.ndarray:
        """The bound (n,) for coordinates (n, 6), from standard normal noise (n, draws, L)."""
        mean, deviation = self.posterior(points)
        z = mean[:, None] + deviation[:, None] * noise
        middle, log_sigma = self._likelihood(z)
        # log p(z) - log q(z | fabric), the factors of 2 pi cancelled ...
        terms = 0.5 * (noise**2 - z**2).sum(axis=-1) + np.log(deviation).sum(axis=-1)[:, None]
        # ... and log p(fabric | z).
        white = (points[:, None] - middle) * np.exp(-log_sigma)
        terms -= (0.5 * white**2 + log_sigma).sum(axis=-1)
        return logsumexp(terms, axis=1) - 3 * np.log(2 * np.pi) - np.log(noise.shape[1])

    def _likelihood(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Mean and log sigma (..., 6) of the coordinates for latent variables (..., L)."""
        middle, output = np.split(run_layers(self.decoder, z), 2, axis=-1)
        return middle, SIGMA_MIDDLE + SIGMA_REACH * np.tanh(output)

    def as_dict(self) -> dict:
        """All parameters, in JSON's types; the weights as base64 of a safetensors file."""
        return {
            "coordinates": self.coordinates.as_dict(),
            "shift": self.shift,
            "spread": list(self.spread),
            "fabrics": self.fabrics,
            "weights": base64.b64encode(save(self.weights)).decode("ascii"),
        }

    @classmethod
    def from_dict(cls, content: dict) -> "VaePrior":
        """The inverse of :meth:`as_dict`; InputError where a parameter makes no sense."""
        shift, spread = read_array(content, "shift", ()), read_array(content, "spread", (2,))
        if shift < 0 or not 0 < spread[0] <= spread[1]:
            raise InputError("'shift' must not be negative, 'spread' two positive numbers in order")
        try:
            weights = load(base64.b64decode(content["weights"], validate=True))
        except (KeyError, TypeError, ValueError, binascii.Error, SafetensorError):
            raise InputError("its 'weights' are not base64 of a safetensors file") from None
        _check_weights(weights)
        return cls(Coordinates.from_dict(content.get("coordinates")), weights,
                   read_count(content, "fabrics"), float(shift), (*map(float, spread),))


def run_layers(layers: Layers, values: np.ndarray) -> np.ndarray:
    """Output (..., out) of the layers for values (..., in), with tanh between them."""
    for weight, bias in layers[:-1]:
        values = np.tanh(values @ weight.T + bias)
    weight, bias = layers[-1]
    return values @ weight.T + bias


def _layers(weights: dict[str, np.ndarray], name: str) -> Layers:
    count = sum(key.startswith(f"{name}.") for key in weights) // 2
    return [tuple(weights[f"{name}.{k}.{part}"].astype(np.float64) for part in ("weight", "bias"))
            for k in range(count)]


def _check_weights(weights: dict[str, np.ndarray]) -> None:
    """InputError unless the arrays are those of an encoder and a decoder that fit each other."""
    shapes, width, ends = {}, 6, []
    for name in ("encoder", "decoder"):
        layer = 0
        while (bias := weights.get(f"{name}.{layer}.bias")) is not None:
            shapes[f"{name}.{layer}.weight"] = (bias.size, width)
            shapes[f"{name}.{layer}.bias"] = (bias.size,)
            width, layer = bias.size, layer + 1
        ends.append((width, layer))
        width //= 2  # of what the encoder gives, half are the means of z
    (inner, encoding), (outer, decoding) = ends
    fits = encoding and decoding and inner % 2 == 0 and outer == 12
    if not fits or {name: array.shape for name, array in weights.items()} != shapes:
        raise InputError("its weights are not those of an encoder and a decoder of 6 numbers")
    if not all(array.dtype == np.float32 and np.isfinite(array).all()
               for array in weights.values()):
        raise InputError("its weights must be finite numbers of type float32")
