"""Networks of studies: inputs, outputs and training data."""

import json
from itertools import product

import numpy as np
import pytest
import torch
from cloths import skirt

from data.render.cameras import nominal_camera
from data.render.rays import DepthRenderer
from drapenet.network.targets import Symmetry, TargetScale
from drapenet.views.directions import AZIMUTHS, ELEVATIONS, elevations
from experiments.__main__ import main
from experiments.papers import networks
from experiments.papers.networks import (
    CaptureSet,
    Classes,
    FoldNetwork,
    MapNetwork,
    Regression,
    ViewNetwork,
    outline,
    output_head,
    stiff_first,
)
from experiments.papers.space import linear_fit
from experiments.papers.trainings import UniformPrior
from sim.drape import drape
from sim.material import SWAPPED, Fabric
from sim.rig import Rig
from sim.scene import make_specimen

RIG = Rig()


def test_regression_has_the_loss_of_the_paper():
    target = torch.tensor([[1.0, 2.0], [0.0, -1.0]])
    answer = Regression(torch.tensor([[0.0, 0.0], [0.0, 1.0]]))
    assert answer.log_likelihood(target).item() == pytest.approx(-np.sqrt((1 + 4 + 4) / 2))


def test_the_likelihood_is_that_of_the_classes_of_the_targets():
    outputs, answer = output_head("classes 8", targets=2)
    assert outputs == 16
    targets = torch.tensor([[0.1, -9.0], [1.3, 2.4]])
    logits = torch.zeros(2, 2, 8)
    for row, places in enumerate([(4, 0), (6, 7)]):  # eight classes from -2.5 to 2.5
        for column, place in enumerate(places):
            logits[row, column, place] = 50.0
    found = answer(logits.view(2, 16))
    assert isinstance(found, Classes)
    assert torch.allclose(found.log_likelihood(targets), torch.zeros(2), atol=1e-5)
    assert torch.allclose(found.mean, torch.tensor([[0.3125, -2.1875], [1.5625, 2.1875]]))


def waves(folds: int) -> tuple[torch.Tensor, torch.Tensor, np.ndarray]:
    """Distance and weight (1, AZIMUTHS, ELEVATIONS) of a cone with a wavy hem, and its radius."""
    azimuth = 2 * np.pi * (np.arange(AZIMUTHS) + 0.5) / AZIMUTHS
    radius = 0.09 + 0.02 * np.cos(folds * azimuth)
    borders = elevations(RIG)
    middle = torch.from_numpy((borders[1:] + borders[:-1]) / 2).float()
    shown = torch.from_numpy(radius).float()[:, None] / middle.cos() * torch.ones(ELEVATIONS)
    weight = torch.ones(AZIMUTHS, ELEVATIONS)
    weight[:, :10] = 0.0  # nothing below the hem
    shown = torch.where(middle > middle[10], 0.5 * shown, shown)  # smaller radius above the hem
    return shown[None], weight[None], radius


def test_an_outline_is_the_hem_of_a_map():
    distance, weight, radius = waves(5)
    found, height = outline(distance, weight)
    np.testing.assert_allclose(found[0], radius, rtol=1e-5)
    borders = elevations(RIG)
    np.testing.assert_allclose(height[0], radius * np.tan((borders[10] + borders[11]) / 2),
                               rtol=1e-4)


@pytest.mark.parametrize("folds", [4, 7])
def test_inputs_are_drape_coefficient_and_number_of_folds(folds):
    distance, weight, radius = waves(folds)
    network = FoldNetwork("regression")
    layer_inputs = []
    network.layers.register_forward_pre_hook(lambda _, inputs: layer_inputs.append(inputs[0]))
    network(distance, weight)
    plate = np.pi * RIG.plate_radius**2
    coefficient = (np.pi * np.mean(radius**2) - plate) / (RIG.specimen_area - plate)
    assert layer_inputs[0][0, 0].item() == pytest.approx(10 * coefficient - 2, rel=1e-4)
    assert layer_inputs[0][0, 1].item() == pytest.approx(folds / 2 - 3)


@pytest.mark.parametrize("name", ["resnet18", "alexnet", "efficientnet_b0"])
def test_backbones_have_inputs_of_four_views_and_a_focal_length(name):
    network = ViewNetwork(name, output="posterior")
    answer = network(torch.rand(2, 5, 60, 80))
    assert answer.means.shape == (2, 2, 6)


def test_a_map_is_read_alike_from_any_azimuth():
    """Around the axis; its place relative to the yarns is an input with a period of half a turn."""
    network = MapNetwork(4, output="regression", distance=0.09, spread=0.02).eval()
    distance, weight, _ = waves(5)
    distance = distance + 0.01 * torch.rand(1, AZIMUTHS, ELEVATIONS)
    here, there, quarter = (network(distance.roll(cells, dims=1), weight).mean
                            for cells in (0, AZIMUTHS // 2, AZIMUTHS // 4))
    assert torch.allclose(here, there, atol=1e-5) and not torch.allclose(here, quarter, atol=1e-5)


def test_targets_do_not_depend_on_the_direction_of_the_warp():
    theta = np.random.default_rng(0).normal(size=(8, 6))
    maps = np.random.default_rng(1).random((8, AZIMUTHS, ELEVATIONS)).astype(np.float16)
    captures, swapped = (CaptureSet.of_maps(
        maps, np.zeros_like(maps, np.uint8), part, np.arange(8),
        TargetScale(np.zeros(6), np.ones(6))) for part in (theta, theta[:, SWAPPED]))
    assert torch.equal(captures.targets, swapped.targets)
    batch, = captures.epoch(seed=0, epoch=0, size=8, symmetric=True)
    plain, = captures.epoch(seed=0, epoch=0, size=8, symmetric=False)
    assert torch.equal(batch.targets, plain.targets)
    assert not torch.equal(batch.inputs[0], plain.inputs[0])
    assert plain.inputs[0].max().item() == pytest.approx(RIG.specimen_size, rel=0.01)  # metres


def test_stiffer_yarns_come_first():
    theta = np.array([[1.0, 2.0, 3.0, 10.0, 20.0, 30.0]])
    assert stiff_first(theta).tolist() == [[3.0, 2.0, 1.0, 30.0, 20.0, 10.0]]


def test_the_uniform_prior_has_the_quantiles_of_the_fabrics_as_bounds():
    theta = np.random.default_rng(0).normal(size=(5000, 6))
    box = UniformPrior.around(theta)
    drawn = box.sample(2000, np.random.default_rng(1))
    assert (drawn >= box.low).all() and (drawn <= box.high).all()
    assert np.allclose(box.high, 2.326, atol=0.15)  # of a normal distribution
    assert np.allclose(drawn.std(axis=0), (box.high - box.low) / np.sqrt(12), rtol=0.03)


def test_a_linear_law_is_fitted_to_a_linear_fabrics_drape():
    fabric = Fabric([60e-6, 40e-6, 50e-6], [0.0, 0.0, 0.0])
    found = linear_fit(drape(fabric, edge=0.009, seed=1, start="ring"))
    np.testing.assert_allclose(found.fabric.alpha, fabric.alpha, rtol=1e-2)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["space", "scaling"])
def test_trainings_are_stored_and_not_repeated(tmp_path, capsys, name):
    words = [name, "drapes=32", "start_drapes=32", "other_drapes=16", "table_drapes=16",
             "captures=1", "steps=2", "batch=8", "edge_mm=9", "workers=1",
             f"work={tmp_path / 'work'}", f"out={tmp_path / 'report.json'}",
             *(["fabrics=10,20", "times=2,3"] if name == "scaling" else [])]
    main(words)
    first = json.loads((tmp_path / "report.json").read_text(encoding="utf-8"))
    capsys.readouterr()
    main(words)
    assert "to go" not in capsys.readouterr().out
    assert json.loads((tmp_path / "report.json").read_text(encoding="utf-8")) == first


def test_symmetries_of_views_are_those_of_the_specimen():
    specimen = make_specimen(RIG, edge=0.015).mesh
    cloth = skirt(edge=0.015)
    camera = nominal_camera()
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])

    def views(positions: np.ndarray) -> torch.Tensor:
        return torch.from_numpy(DepthRenderer(positions, specimen.faces).views(camera, 0.3))

    for quarters, mirror in product(range(4), (False, True)):
        symmetry = Symmetry(torch.tensor([32 * quarters]), torch.tensor([mirror]))
        found, = networks.turn_views(symmetry, views(cloth.positions)[None])
        spun = np.linalg.matrix_power(turn, quarters)
        first = np.array([[np.cos(0.3), -np.sin(0.3), 0], [np.sin(0.3), np.cos(0.3), 0], [0, 0, 1]])
        shown = cloth.positions @ first.T * ([-1, 1, 1] if mirror else 1) @ spun.T @ first
        assert torch.isclose(found, views(shown), atol=1e-3).float().mean() > 0.99


def test_downsampled_views_are_means_over_cloth_pixels():
    views = np.zeros((1, 6, 6), np.float32)
    views[0, :3, :3], views[0, 0, 0] = 0.65, 0.0
    views[0, 3, 3:] = 0.6
    downsampled = networks.downsample(views)
    np.testing.assert_allclose(downsampled, [[[1.0, 2.0], [2.0, 2.0]]], atol=1e-3)
