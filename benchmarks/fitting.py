"""Trainings without an end in epochs, and errors that networks of different targets share."""

import time
from collections.abc import Callable
from itertools import chain, count

import numpy as np
import torch

from drapenet.config import OptimConfig, learning_rate
from drapenet.convention import FIRST, SECOND, SWAPPED
from drapenet.targets import MODULI, TargetScale
from drapenet.training import CaptureSet

_AT_ONCE = 64  # captures


def fit(
    network: torch.nn.Module, captures: CaptureSet, *, share: Callable[[int], float], batch: int,
    seed: int,
) -> int:
    """Train as ``train.py`` does; the number of steps it took.

    Args:
        network: in training mode or not; it is left in evaluation mode.
        share: of the training that is done after so many steps; it ends at 1.
        batch: captures a step.
        seed: of their order.
    """
    optim, done = OptimConfig(batch_size=batch), 0
    optimizer = torch.optim.AdamW(network.parameters(), weight_decay=optim.weight_decay)
    network.train()
    batches = chain.from_iterable(captures.epoch(seed=seed, epoch=epoch, size=batch)
                                  for epoch in count())
    while (progress := share(done)) < 1:
        part = next(batches)
        for group in optimizer.param_groups:
            group["lr"] = learning_rate(optim, progress)
        loss = -part.through(network).log_likelihood(part.targets).mean()
        optimizer.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(network.parameters(), optim.clip)
        optimizer.step()
        done += 1
    network.eval()
    return done


def processor_seconds(seconds: float) -> Callable[[int], float]:
    """The share done, for :func:`fit`, of a training of so much processor time from now on."""
    began = time.process_time()
    return lambda _: (time.process_time() - began) / seconds


@torch.no_grad()
def errors(network: torch.nn.Module, captures: CaptureSet, scale: TargetScale) -> np.ndarray:
    """(N, 6) error of the posterior's mean of theta, stiff, bias, soft, of each capture."""
    found = []
    for rows in np.array_split(np.arange(len(captures)), -(-len(captures) // _AT_ONCE)):
        mixture = captures.batch(rows, revealed=np.zeros((len(rows), 2), bool)).through(network)
        mean = (mixture.logits.softmax(dim=1)[..., None] * mixture.means).sum(dim=1)
        found.append(scale.decode(mean.numpy())[:, :MODULI])
    return stiff_first(np.concatenate(found)) - stiff_first(captures.maps.theta)


def stiff_first(theta: np.ndarray) -> np.ndarray:
    """theta (N, 6) with the stiffer yarns first."""
    return np.where(theta[:, [FIRST]] < theta[:, [SECOND]], theta[:, SWAPPED], theta)
