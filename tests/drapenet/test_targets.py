"""Targets, their symmetries, and what the network does with them."""

import numpy as np
import pytest
import torch

from drapenet.network.model import KNOWN, MapNet, known_of
from drapenet.network.targets import Symmetry, TargetScale, targets_of
from drapenet.views.directions import AZIMUTHS, ELEVATIONS
from sim.material import SWAPPED

THETA = np.array([[-10.0, -10.5, -11.0, -1e-3, -2e-3, -3e-3]])


@pytest.mark.parametrize("quarters", range(-2, 5))
def test_the_yarns_along_azimuth_0_come_first(quarters):
    warp = np.array([quarters * np.pi / 2 + 0.3])
    expected = THETA[:, SWAPPED] if quarters % 2 else THETA
    assert np.array_equal(targets_of(THETA, warp, disc=False), expected)


@pytest.mark.parametrize(("theta", "stiff"), [(THETA, 0.4), (THETA[:, SWAPPED], 0.4 + np.pi / 2)])
def test_targets_of_a_disc_are_sorted_and_have_a_direction(theta, stiff):
    targets = targets_of(theta, np.array([0.4]), disc=True)
    assert targets[:, :6] == pytest.approx(THETA)
    weight = np.tanh(1.0)
    assert targets[0, 6:] == pytest.approx([weight * np.cos(2 * stiff), weight * np.sin(2 * stiff)])


@pytest.mark.parametrize("disc", [False, True])
def test_a_turned_map_is_that_of_a_turned_specimen(disc):
    """A bump stands for the warp: it must go where the targets say."""
    symmetry = Symmetry.draw(40, disc=disc, rng=np.random.default_rng(2))
    warp_cell = 10
    warp = (warp_cell + 0.5) * 2 * np.pi / AZIMUTHS
    maps = torch.zeros(40, AZIMUTHS, ELEVATIONS)
    maps[:, warp_cell] = 1.0
    moved = symmetry.of_maps(maps)[:, :, 0].argmax(dim=1)
    turned = (moved.numpy() + 0.5) * 2 * np.pi / AZIMUTHS
    before = torch.from_numpy(targets_of(THETA.repeat(40, 0), np.full(40, warp), disc=disc))
    after = targets_of(THETA.repeat(40, 0), turned, disc=disc)
    assert symmetry.of_targets(before, disc=disc).numpy() == pytest.approx(after, abs=1e-6)
    assert symmetry.undone(torch.from_numpy(after), disc=disc).numpy() == pytest.approx(
        before.numpy(), abs=1e-6)


def test_the_scale_of_a_square_does_not_know_warp_from_weft():
    targets = np.random.default_rng(0).normal(size=(50, 6)) * np.arange(1, 7)
    scale = TargetScale.fit(targets, disc=False)
    assert np.array_equal(scale.mean, scale.mean[SWAPPED])
    assert np.array_equal(scale.std, scale.std[SWAPPED])
    assert scale.decode(scale.encode(targets)) == pytest.approx(targets)


def test_the_scale_of_a_disc_turns_with_it():
    targets = np.random.default_rng(0).normal(size=(50, 8)) + 0.3
    scale = TargetScale.fit(targets, disc=True)
    assert scale.mean[6:].tolist() == [0.0, 0.0] and scale.std[6] == scale.std[7]


def test_the_network_closes_around_the_axis():
    """A map turned by a quarter gives the features turned, so averages over it stay."""
    torch.manual_seed(0)
    network = MapNet(width=4, components=2, targets=6, distance=0.1, spread=0.02).eval()
    maps = torch.randn(1, AZIMUTHS, ELEVATIONS)
    stages = torch.nn.Sequential(network.stem, network.stages)
    channels = maps.transpose(1, 2)[:, None].expand(-1, 4, -1, -1)
    first = stages(channels)
    second = stages(channels.roll(AZIMUTHS // 4, dims=3))
    assert torch.allclose(first.roll(first.shape[3] // 4, dims=3), second, atol=1e-5)


def test_what_is_not_known_has_a_flag():
    """The last two inputs state that there is no friction beside the moduli."""
    known = known_of(torch.tensor([4, 8]), torch.tensor([316.0, np.nan]))
    assert known.shape == (2, KNOWN)
    assert known.tolist() == pytest.approx(np.array([[0, 1, 0, 1, -1], [1, 0, 0, 1, -1]]), abs=1e-6)
