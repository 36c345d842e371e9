"""The network of stacked depth views: trained, evaluated and used by the same commands."""

import json
from pathlib import Path

import cloths
import numpy as np
import pytest
import torch
from test_train import SMALL
from words import last

import drapenet.network.evaluate
import train
from common.errors import InputError
from data.captures.capture import read_capture
from data.dataset.folder import finished_manifest
from drapenet.inference import network_estimate
from drapenet.network import training as steps
from drapenet.network.captures import CaptureSet
from drapenet.network.checkpoint import Header, load_model, read_header
from drapenet.network.dataset import Maps
from drapenet.network.evaluate import CELLS
from drapenet.network.model import make_network
from drapenet.network.posterior import Mixture, factor_of
from drapenet.network.predict import predict
from drapenet.network.targets import TARGETS, Symmetry
from drapenet.views.observation import Observation
from drapenet.views.outline import DrapeOutline
from drapenet.views.pictures import SIDE
from sim.rig import DISC_RIG, Rig

VIEWS = ["model=views", "model.width=16", "optim.learning_rate=0.001"]


@pytest.fixture(scope="module")
def words(cloth_dataset, tmp_path_factory) -> list[str]:
    folder = tmp_path_factory.mktemp("views")
    return last(f"data={cloth_dataset}", f"maps={folder / 'maps'}", f"out={folder / 'out'}",
                *SMALL, *VIEWS, "epochs=1", "captures=1")[:]


@pytest.fixture(scope="module")
def header(words) -> Header:
    """Of the paper's network after an epoch."""
    train.main([word for word in words if not word.startswith("model.width=4")])
    return read_header(Path(words[2].removeprefix("out=")) / "drapenet.safetensors")


def test_the_papers_network_is_a_configuration_of_the_command(header):
    assert (header.model.backbone, header.model.output) == ("resnet18", "regression")
    assert header.config.inputs == ["depth"] and header.setups.views == (0, 0, 0, 1)
    network = load_model(header)
    first = network.backbone.conv1
    assert first.in_channels == 4 and network.backbone.fc.out_features == 16
    assert header.validation["samples"] == 5 and 0 < header.model.spread < 0.5
    # What validation left unexplained, in deviations over fabrics.
    covariance = torch.linalg.inv(network.factor @ network.factor.T)
    assert torch.allclose(covariance, covariance.T, rtol=1e-3, atol=1e-3)
    assert 0.1 < covariance.diagonal()[:3].mean().sqrt() < 4


def test_a_capture_is_estimated_from_its_pictures(header, tmp_path):
    one, other = (network_estimate(read_capture(cloths.write_skirt(
        tmp_path / str(orientation), orientation=orientation, warp_direction=orientation)), header)
        for orientation in (0.4, 0.4 + np.pi / 2))
    middle, there = (found.estimate.samples.mean(axis=0) for found in (one, other))
    spread = one.estimate.samples.std(axis=0)
    # The same views, later: the same answer. Another cloth: another answer.
    assert (there - middle) / spread == pytest.approx(np.zeros(6), abs=0.1)
    seen, network = one.observation, load_model(header)
    flipped = np.ascontiguousarray(seen.pictures.depth[:, ::-1])
    changed = Observation(**vars(seen) | {"pictures": type(seen.pictures)(flipped, 0.0)})
    drawn, = predict(network, header, [[changed]])
    assert np.abs((drawn.cloth.theta.mean(axis=0) - middle) / spread).max() > 1e-3


@pytest.mark.parametrize(("observation", "message"), [
    (Observation(DISC_RIG, 1, True, outline=DrapeOutline(np.full(128, 0.12), 1.0)),
     r"was trained to read depth, not outline alone; give .* inputs=\[outline\]"),
    (Observation(DISC_RIG, 1, True, coefficient=0.5, nodes=6), "depth, not numbers alone"),
])
def test_what_it_has_not_learned_to_read_is_refused(header, observation, message):
    with pytest.raises(InputError, match=message) as refusal:
        predict(load_model(header), header, [[observation]])
    assert "\n" not in str(refusal.value)


def test_views_that_were_not_kept_are_refused(header, tmp_path):
    seen = network_estimate(read_capture(cloths.write_skirt(tmp_path, warp_direction=0.4)),
                            header).observation
    with pytest.raises(InputError, match="not kept beside an estimate; estimate the capture"):
        predict(load_model(header), header, [[Observation(**vars(seen) | {"pictures": None})]])


def test_it_is_evaluated_on_what_it_reads(header, tmp_path, monkeypatch):
    def make(config: object, out: Path, *, workers: int) -> dict:
        if not out.exists():
            cloths.write_dataset(out, drapes=3, seed=config.sampling.seed)
        return finished_manifest(out)

    names = ("depth, 4 views", "outline, parallel light", "drape coefficient and nodes")
    monkeypatch.setattr(drapenet.network.evaluate, "generate_dataset", make)
    monkeypatch.setattr(drapenet.network.evaluate, "CELLS", {name: CELLS[name] for name in names})
    drapenet.network.evaluate.main([
        f"checkpoint={header.path}", f"out={tmp_path}", f"testers=[{Rig().name}]",
        "fabrics_per_tester=1", "captures=1", "seed=5", "workers=1"])
    cells = json.loads((tmp_path / "evaluation.json").read_text())["cells"][Rig().name]
    assert list(cells) == ["depth, 4 views"] and cells["depth, 4 views"]["sets"] == 6


@pytest.mark.parametrize("backbone", ["alexnet", "efficientnet_b0", "resnet34"])
def test_other_backbones_have_four_channels(backbone):
    network = make_network(backbone=backbone, output="posterior", width=8, components=2,
                           dropout=0.0, distance=0.0, spread=0.2).eval()
    batch = shapes(3, 2, seed=0)[0].batch(np.arange(2), steps.Condition((1.0, 0.0, 0.0), (1.0,)),
                                          np.random.default_rng(0))[0]
    assert batch.through(network).means.shape == (2, 2, TARGETS)


def shapes(count: int, repeats: int, *, seed: int) -> tuple[CaptureSet, Maps]:
    """Captures whose pictures show bars that stand out the more, the stiffer the fabric."""
    from test_train import stiff_maps

    maps = stiff_maps(count, seed=seed)
    stiff = ((maps.theta[:, [0, 1, 2]] + 11) / 0.8)[:, :, None, None]
    depth = np.full((count, 4, SIDE, SIDE), np.nan, np.float16)
    depth[:, :, 32:96, 32:96] = 0.0
    for view, yarn in enumerate((0, 2, 0, 2)):  # warp and weft in turn, bias in all
        depth[:, view, 32:60, 32:96] = 0.2 * stiff[:, yarn]
        depth[:, view, 68:96, 32:96] = 0.2 * stiff[:, 1]
    columns = vars(maps) | {"pictures": depth, "angle": np.zeros(count)}
    return CaptureSet(Maps(**columns)), maps


def test_the_view_network_tells_warp_from_weft_by_the_order_of_its_pictures():
    torch.manual_seed(0)
    training, _ = shapes(96, 1, seed=0)
    unseen = CaptureSet(shapes(48, 1, seed=1)[0].maps, scale=training.scale)
    condition = steps.Condition((1.0, 0.0, 0.0), (1.0,), known=1.0)
    config = steps_model(backbone="resnet18", output="regression")
    network = make_network(**training.network(config))
    optim = steps_optim(learning_rate=2e-3, batch_size=24)
    batches = [batch for epoch in range(6) for batch in training.epoch(
        seed=0, epoch=epoch, size=24, condition=condition)]
    steps.fit(network, ((step / len(batches), batch) for step, batch in enumerate(batches)),
              optimizer=torch.optim.AdamW(network.parameters()), optim=optim)
    metrics = steps.validate(network, unseen, condition)
    assert metrics["rmse_log_alpha"] < 0.6  # 1 without the pictures, 0.8 without their order
    assert 0.5 < metrics["inside"]["68%"] < 0.85
