"""Training of the autoencoder of :mod:`data.fabrics.prior.vae`."""

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    import torch

BATCH = 16  # fabrics per step, as in the paper
WEIGHT_DECAY = 1e-5  # as in the paper
DRAWS = 8
WARM_UP = 0.25  # share of the steps in which the weight of log p(z) / q(z | fabric) rises to 1


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
    weights: dict[str, Any] = {}
    for name, network in (("encoder", encoder), ("decoder", decoder)):
        for k, layer in enumerate(network[::2]):
            weights |= {f"{name}.{k}.weight": layer.weight, f"{name}.{k}.bias": layer.bias}
    return {name: value.detach().numpy().copy() for name, value in weights.items()}
