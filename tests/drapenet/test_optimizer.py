"""The optimiser of the network."""

import pytest
import torch

from drapenet.network.model import make_network
from drapenet.network.optimizer import Optimizer, _Muon


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


@pytest.mark.parametrize("shape", [(12, 40), (40, 12)])
def test_steps_in_single_precision_are_torchs_without_its_rounding(shape):
    torch.manual_seed(0)
    start = torch.randn(shape)
    one, other = (torch.nn.Parameter(start.clone()) for _ in range(2))
    optimizers = [kind([part], lr=0.02, weight_decay=0.1, adjust_lr_fn="match_rms_adamw")
                  for kind, part in ((_Muon, one), (torch.optim.Muon, other))]
    for _ in range(3):
        one.grad = torch.randn(shape)
        other.grad = one.grad.clone()
        for optimizer in optimizers:
            optimizer.step()
    assert 0 < (one - other).norm() < 0.03 * (one - start).norm()
    momenta = (optimizer.state_dict()["state"][0]["momentum_buffer"] for optimizer in optimizers)
    torch.testing.assert_close(*momenta)
