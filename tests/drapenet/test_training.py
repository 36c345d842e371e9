"""Does the network learn what maps show, in the specimen's own axes?"""

import numpy as np
import pytest
import torch

from drapenet.config import ModelConfig
from drapenet.network.dataset import Maps
from drapenet.network.model import MapNet
from drapenet.network.training import CaptureSet, validate
from drapenet.views.radial_map import AZIMUTHS, ELEVATIONS


def shown(count: int, *, disc: bool, seed: int) -> Maps:
    """Maps that stand out further where the cloth is stiffer, along warp, bias and weft."""
    rng = np.random.default_rng(seed)
    theta = np.column_stack([rng.normal(-11, 0.8, (count, 3)), rng.normal(-2e-3, 1e-3, (count, 3))])
    warp = rng.uniform(0, 2 * np.pi, count) if disc else rng.integers(4, size=count) * np.pi / 2
    azimuth = 2 * np.pi * (np.arange(AZIMUTHS) + 0.5) / AZIMUTHS - warp[:, None]
    yarns, bias = (theta[:, [0]] + theta[:, [2]]) / 2, theta[:, [1]]
    stiffness = ((yarns + bias) / 2 + (theta[:, [0]] - theta[:, [2]]) / 2 * np.cos(2 * azimuth)
                 + (yarns - bias) / 2 * np.cos(4 * azimuth))
    distance = 0.08 + 0.01 * (stiffness + 11)
    distance = np.repeat(distance[:, :, None], ELEVATIONS, axis=2).astype(np.float16)
    nuisances = np.tile([316.0, 1.0, 1e-4, 0, 0, 0, 0, 0], (count, 1))
    return Maps(distance, np.full_like(distance, 22, dtype=np.uint8), theta, warp, nuisances,
                np.full(count, 4), np.arange(count), np.arange(count), np.zeros(count, bool))


@pytest.mark.parametrize(("disc", "epochs", "most"), [(False, 6, 0.5), (True, 12, 0.72)])
def test_training_learns_all_three_directions(
    disc: bool, epochs: int, most: float, one_thread: None
) -> None:
    """Without the directions the errors would be 0.8, without anything 1."""
    training, unseen = (shown(count, disc=disc, seed=seed) for count, seed in ((640, 0), (128, 1)))
    training = CaptureSet(training, disc=disc)
    unseen = CaptureSet(unseen, disc=disc, scale=training.scale)
    torch.manual_seed(0)
    network = MapNet(**training.network(ModelConfig(width=4, components=1)))
    optimizer = torch.optim.AdamW(network.parameters(), lr=5e-3)
    for epoch in range(epochs):
        network.train()
        for batch in training.epoch(seed=0, epoch=epoch, size=32):
            loss = -batch.through(network).log_likelihood(batch.targets).mean()
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
    metrics = validate(network, unseen)
    assert metrics["rmse_log_alpha"] < most
    assert 0.85 < metrics["rmse_beta_over_alpha"] < 1.2  # the maps do not show it
    assert 0.4 < metrics["inside"]["68%"] < 0.9
