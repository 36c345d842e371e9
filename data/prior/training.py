"""Training of the autoencoder that serves as prior."""

import math
from itertools import pairwise

import numpy as np
import torch
from torch import nn

from data.prior.architecture import SIGMA_MIDDLE, SIGMA_REACH, Architecture

BATCH = 16  # fabrics a step, as in the paper
WEIGHT_DECAY = 1e-5  # as in the paper
DRAWS = 8
WARM_UP = 0.25  # share of the steps in which p(z) / q(z | fabric) gains its full weight


def train(
    points: np.ndarray, architecture: Architecture, *, noise: float = 0.0, seed: int = 0
) -> dict[str, np.ndarray]:
    """Weights of an autoencoder (see :class:`data.prior.vae.VaePrior`) of points (F, 6).

    Adam maximises the importance-weighted bound on the likelihood, of ``DRAWS`` latent vectors a
    fabric (Burda, Grosse and Salakhutdinov 2016); with one, the usual bound, more of the latent
    variables stay unused. The ratio of p(z) to q(z | fabric) grows from no weight to its full
    weight, the learning rate falls along a cosine.

    Args:
        noise: standard deviation of what is added to a fabric each time it is seen, in
            deviations of the table.
        seed: of the first weights, the batches and all noise.
    """
    threads = torch.get_num_threads()
    torch.set_num_threads(1)  # sums do not depend on the machine's number of cores
    try:
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            return _train(torch.tensor(points, dtype=torch.float32), architecture, noise)
    finally:
        torch.set_num_threads(threads)


def _train(
    points: torch.Tensor, architecture: Architecture, noise: float
) -> dict[str, np.ndarray]:
    hidden, latent = architecture.hidden, architecture.latent
    encoder = _network([6, *hidden, 2 * latent])
    decoder = _network([latent, *reversed(hidden), 12])
    optimiser = torch.optim.Adam(
        [*encoder.parameters(), *decoder.parameters()], lr=architecture.learning_rate,
        weight_decay=WEIGHT_DECAY, fused=True)
    steps = architecture.steps
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, steps)
    for step in range(steps):
        batch = points[torch.randint(len(points), (BATCH,))]
        if noise:
            batch = batch + noise * torch.randn_like(batch)
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


def _network(sizes: list[int]) -> nn.Sequential:
    """Layers of these sizes with tanh between them."""
    layers: list[nn.Module] = []
    for before, after in pairwise(sizes):
        layers += [nn.Linear(before, after), nn.Tanh()]
    return nn.Sequential(*layers[:-1])
