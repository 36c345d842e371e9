"""The network of stacked depth views: trained, evaluated and used by the same commands."""

import json
from dataclasses import replace
from pathlib import Path

import cloths
import numpy as np
import pytest
import torch
from checkpoints import use_skirts
from test_train import SMALL, few_features, learned, stiff_maps  # noqa: F401
from words import last

import drapenet.network.evaluate
import train
from common.errors import InputError
from data.captures.reader import read_capture
from drapenet.fabric.stages import by_network
from drapenet.network.captures import CaptureSet, Condition
from drapenet.network.checkpoint import Header, read_header
from drapenet.network.evaluate import DEPTH
from drapenet.network.model import make_network
from drapenet.network.predict import network_of, predict
from drapenet.network.targets import TARGETS
from drapenet.network.training import validate
from drapenet.network.weights import Loaded, load_model
from drapenet.result.files import read_observation, write_observation
from drapenet.views.observation import Observation
from drapenet.views.outline import DrapeOutline
from drapenet.views.pictures import PICTURES, SIDE, DepthPictures
from sim.rig import DISC_RIG, Rig

ALONE = Condition(DEPTH, (1.0,), known=1.0)


@pytest.fixture(scope="module")
def words(cloth_dataset, tmp_path_factory) -> list[str]:
    folder = tmp_path_factory.mktemp("views")
    return last(f"data={cloth_dataset}", f"maps={folder / 'maps'}", f"out={folder / 'out'}",
                *SMALL, "model=views", "model.width=16", "epochs=1", "captures=1")


@pytest.fixture(scope="module")
def header(words) -> Header:
    """Of the paper's network after an epoch."""
    train.main(words)
    return read_header(Path(words[2].removeprefix("out=")) / "drapenet.safetensors")


def test_the_papers_network_is_a_configuration_of_the_command(header):
    assert (header.model.backbone, header.model.output) == ("resnet18", "regression")
    assert header.config.inputs == ["depth"] and header.setups.views == (0, 0, 0, 1)
    network = load_model(header)
    first = network.backbone.conv1
    assert first.in_channels == 4 and network.backbone.fc.out_features == 16
    assert header.validation["samples"] == 3 and 0 < header.model.spread < 0.5
    # What validation left unexplained, in deviations over fabrics.
    covariance = torch.linalg.inv(network.factor @ network.factor.T)
    assert torch.allclose(covariance, covariance.T, rtol=1e-3, atol=1e-3)
    assert 0.1 < covariance.diagonal()[:3].mean().sqrt() < 4


def test_a_capture_is_estimated_from_its_pictures(header, tmp_path):
    one, other = (by_network(read_capture(cloths.write_skirt(
        tmp_path / str(orientation), orientation=orientation, warp_direction=orientation)), header)
        for orientation in (0.4, 0.4 + np.pi / 2))
    middle, there = (found.estimate.samples.mean(axis=0) for found in (one, other))
    spread = one.estimate.samples.std(axis=0)
    # The same views, later: the same answer. Another cloth: another answer.
    assert (there - middle) / spread == pytest.approx(np.zeros(6), abs=0.1)
    seen, network = one.observed.seen, network_of(header)
    flipped = np.ascontiguousarray(seen.pictures.depth[:, ::-1])
    changed = Observation(**vars(seen) | {"pictures": DepthPictures(flipped, 0.0)})
    drawn, = predict(network, header, [[changed]])
    assert np.abs((drawn.cloth.theta.mean(axis=0) - middle) / spread).max() > 1e-3


@pytest.mark.parametrize(("observation", "message"), [
    (Observation(DISC_RIG, 1, True, outline=DrapeOutline(np.full(128, 0.12), 1.0)),
     r"was trained to read depth, not outline alone; give .* inputs=\[outline\]"),
    (Observation(DISC_RIG, 1, True, coefficient=0.5, nodes=6), "depth, not numbers alone"),
])
def test_what_it_has_not_learned_to_read_is_refused(header, observation, message):
    with pytest.raises(InputError, match=message) as refusal:
        predict(network_of(header), header, [[observation]])
    assert "\n" not in str(refusal.value)


def test_views_are_kept_with_an_estimate_and_join_captures(header, tmp_path):
    seen = by_network(read_capture(cloths.write_skirt(tmp_path, warp_direction=0.4)),
                            header).observed.seen
    write_observation(tmp_path, seen)
    kept = read_observation(tmp_path)
    assert (np.nan_to_num(kept.pictures.depth) == np.nan_to_num(seen.pictures.depth)).all()
    network = network_of(header)
    one, again = (predict(network, header, [[part, part]])[0].cloth.theta
                  for part in (seen, kept))
    assert again == pytest.approx(one, rel=1e-6)


def test_it_is_evaluated_on_what_it_reads(header, tmp_path, monkeypatch):
    use_skirts(monkeypatch, "depth, 4 views", "outline, parallel light",
               "drape coefficient and nodes")
    drapenet.network.evaluate.main([
        f"checkpoint={header.path}", f"out={tmp_path}", f"testers=[{Rig().name}]",
        "fabrics_per_tester=1", "captures=1", "seed=5", "workers=1"])
    cells = json.loads((tmp_path / "evaluation.json").read_text())["cells"][Rig().name]
    assert list(cells) == ["depth, 4 views"] and cells["depth, 4 views"]["sets"] == 6


def shapes(count: int, *, seed: int, side: int = SIDE) -> CaptureSet:
    """Captures whose pictures show two bars: one nearer to the camera the stiffer the warp or the
    weft, whichever is seen from this side, and one the stiffer the bias."""
    maps = stiff_maps(count, seed=seed)
    stiff = ((maps.theta[:, :3] + 11) / 0.8)[:, :, None, None]
    depth = np.full((count, PICTURES, side, side), np.nan, np.float16)
    half, inside = side // 2, slice(side // 4, 3 * side // 4)
    for view, yarn in enumerate((0, 2, 0, 2)):
        depth[:, view, inside.start : half - 1, inside] = -0.2 * stiff[:, yarn]
        depth[:, view, half + 1 : inside.stop, inside] = -0.2 * stiff[:, 1]
    return CaptureSet(replace(maps, pictures=depth))


@pytest.mark.slow
def test_it_tells_warp_from_weft_by_the_order_of_its_pictures():
    network, unseen = learned(
        shapes(160, seed=0, side=32), shapes(64, seed=1, side=32), ALONE, epochs=8, rate=1e-3,
        backbone="resnet18", output="regression", width=32)
    metrics = validate(network, unseen, ALONE)
    assert metrics["rmse_log_alpha"] < 0.6  # 1 without the pictures, 0.8 without their order
    assert 0.4 < metrics["inside"]["68%"] < 0.9


@pytest.mark.parametrize("backbone", ["alexnet", "efficientnet_b0", "resnet34"])
def test_other_backbones_read_four_pictures(backbone):
    network = make_network(backbone=backbone, output="posterior", width=8, components=2,
                           dropout=0.0, distance=0.0, spread=0.2).eval()
    batch, _ = shapes(2, seed=0).batch(np.arange(2), ALONE, np.random.default_rng(0))
    answer = network.answer(batch)
    assert answer.means.shape == (2, 2, TARGETS)
    answer.means.sum().backward()
    first = next(part for part in network.modules() if isinstance(part, torch.nn.Conv2d))
    assert (first.weight.grad.abs().sum(dim=(0, 2, 3)) > 0).tolist() == [True] * PICTURES


def test_the_warp_of_a_disc_matters_only_where_it_is_stated():
    """Azimuth 0 is anywhere on a disc, so the angle of its first picture means nothing."""
    network = make_network(backbone="resnet18", output="regression", width=8, components=1,
                           dropout=0.0, distance=0.0, spread=0.2).eval()
    discs = CaptureSet(replace(shapes(2, seed=0).maps, disc=np.ones(2, bool)))
    for known in (0.0, 1.0):
        batch, _ = discs.batch(np.arange(2), replace(ALONE, known=known), np.random.default_rng(0))
        one, other = (Loaded(network).posterior(replace(
            batch, angle=np.full(2, angle, np.float32))).means for angle in (0.0, 0.7))
        assert np.array_equal(one, other) == (not known)
