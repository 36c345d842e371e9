"""The optimiser of the network."""

import pytest
import torch

from drapenet.network.model import make_network
from drapenet.network.optimizer import Optimizer


@pytest.mark.parametrize("backbone", [None, "resnet18"])
def test_every_direction_of_a_hidden_weight_moves_as_far(backbone):
    """By 0.2 times the root of the larger side, within the error of five Newton-Schulz steps; the
    other weights, biases and norms by the rate; and without a gradient nothing moves."""
    torch.manual_seed(0)
    network = make_network(backbone=backbone, width=8, components=2, dropout=0.0, distance=0.5,
                           spread=0.1, expected=True)
    optimizer = Optimizer(network, weight_decay=0.0)
    before = {name: part.detach().clone() for name, part in network.named_parameters()}
    for part in network.parameters():
        part.grad = torch.randn_like(part)
    still = network.curl.bias
    still.grad = None
    optimizer.step(1e-3)
    hidden = {id(part) for part in network.hidden_weights()}
    assert len(hidden) > 15
    for name, part in network.named_parameters():
        moved = (before[name] - part.detach()) / 1e-3
        if part is still:
            assert not moved.any()
        elif id(part) in hidden:
            moved = moved.flatten(1) / (0.2 * max(moved.flatten(1).shape) ** 0.5)
            values = torch.linalg.svdvals(moved)
            assert values.min() > 0.3 and values.max() < 1.4, name
        else:
            assert moved.abs().sub(1).abs().max() < 0.01, name
        assert part.grad is None
