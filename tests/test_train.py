"""train.py as a user runs it: it learns, and an interruption changes nothing."""

import json
from pathlib import Path

import numpy as np
import pytest
import torch
from blobs import blob_views, write_dataset
from omegaconf import OmegaConf
from safetensors.torch import load_file

import drapenet.model
import train
from common.errors import InputError
from data.configs import compose_config
from data.sensor import load_sensor, sensor_from_config
from data.view_order import ORDERS, reorder_views
from drapenet.checkpoint import load_model, read_header
from drapenet.config import OptimConfig, TrainConfig, learning_rate
from drapenet.preprocess import prepare
from drapenet.training import open_splits, training_batches

SMALL = ["model.input_width=32", "model.input_height=24", "optim.batch_size=16", "threads=1",
         "workers=0", "device=cpu", "optim.learning_rate=0.001", "seed=3"]


@pytest.fixture(autouse=True)
def small_network(monkeypatch: pytest.MonkeyPatch) -> None:
    """A network with the parts that matter here (batch statistics, Adam), at little cost."""
    monkeypatch.setitem(drapenet.model.BACKBONES, "resnet18", SmallNetwork)


class SmallNetwork(torch.nn.Module):
    """Stands for a torchvision network: options, ``conv1``, and a state."""

    def __init__(self, *, weights: None, num_classes: int) -> None:
        super().__init__()
        self.conv1 = torch.nn.Conv2d(3, 12, kernel_size=7)
        self.rest = torch.nn.Sequential(
            torch.nn.BatchNorm2d(12), torch.nn.ReLU(), torch.nn.MaxPool2d(2),
            torch.nn.Conv2d(12, 24, kernel_size=3, padding=1), torch.nn.BatchNorm2d(24),
            torch.nn.ReLU(), torch.nn.AdaptiveAvgPool2d((3, 4)), torch.nn.Flatten(),
            torch.nn.Linear(24 * 12, num_classes),
        )

    def forward(self, views: torch.Tensor) -> torch.Tensor:
        return self.rest(self.conv1(views))


def words(dataset: Path, out: Path, *more: str) -> list[str]:
    return [f"data={dataset}", f"out={out}", *SMALL, *more]


def weights(out: Path) -> dict[str, torch.Tensor]:
    return load_file(out / "state.safetensors")


@pytest.mark.parametrize(("views", "dataset", "orientations"), [
    ("stored", "blob", 1), ("cached", "blob", 2), ("cached", "cloth", 2), ("fresh", "cloth", 2)])
def test_resumed_training_ends_bit_for_bit_like_an_uninterrupted_one(
    request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, views: str,
    dataset: str, orientations: int,
) -> None:
    dataset = request.getfixturevalue(f"{dataset}_dataset")
    settings = ["epochs=3", "optim=cpu_short", f"views={views}",
                f"orientations_per_epoch={orientations}"]
    train.main(words(dataset, tmp_path / "whole", *settings))

    real, calls = train.drape_loss, []

    def interrupt(*args: object, **options: object) -> torch.Tensor:
        calls.append(None)
        if len(calls) == steps + 2:  # within the second epoch
            raise KeyboardInterrupt
        return real(*args, **options)

    config = OmegaConf.to_object(
        compose_config("train", words(dataset, tmp_path, *settings), schema=TrainConfig))
    training, _, _ = open_splits(config)
    steps = len(training_batches(training, epoch=0, config=config))
    assert steps >= 2
    monkeypatch.setattr(train, "drape_loss", interrupt)
    with pytest.raises(KeyboardInterrupt):
        train.main(words(dataset, tmp_path / "broken", *settings))
    monkeypatch.setattr(train, "drape_loss", real)
    train.main(words(dataset, tmp_path / "broken", *settings, f"workers={orientations - 1}"))

    whole, resumed = weights(tmp_path / "whole"), weights(tmp_path / "broken")
    assert whole.keys() == resumed.keys()
    for name, value in whole.items():
        assert torch.equal(value, resumed[name]), name
    first, second = (read_header(tmp_path / run / "drapenet").content
                     for run in ("whole", "broken"))
    assert first["weights"] == second["weights"]
    assert first["validation"] == second["validation"]


def test_training_starts_from_given_weights(blob_dataset: Path, tmp_path: Path) -> None:
    """One epoch at a vanishing rate leaves the first run's weights as they are."""
    full = "half_precision=false"
    train.main(words(blob_dataset, tmp_path / "first", "epochs=1", full))
    train.main(words(blob_dataset, tmp_path / "second", "epochs=1", "optim.learning_rate=1e-12",
                     full, f"initial={tmp_path / 'first' / 'drapenet.safetensors'}"))
    first, second = (load_file(tmp_path / run / "drapenet.safetensors")
                     for run in ("first", "second"))
    learned = [name for name in first if name.endswith("weight")]
    assert learned
    for name in learned:
        assert torch.allclose(first[name], second[name], atol=1e-8), name


def test_training_learns_what_the_pictures_show(blob_dataset: Path, tmp_path: Path) -> None:
    train.main(words(blob_dataset, tmp_path, "epochs=15", "optim=cpu_short", "views=cached",
                     "orientations_per_epoch=2", "sensor=none", "half_precision=false"))
    header = read_header(tmp_path / "drapenet.safetensors")
    assert header.content["validation"]["rmse"]["log_alpha_bias"] < 0.75  # the mean scores 1
    assert load_model(header).training is False
    state = json.loads((tmp_path / "drapenet.json").read_text())
    assert state["dataset"]["sha256"] == f"{0:064x}"
    assert state["config"]["model"]["input_width"] == 32


def test_another_setting_in_the_same_folder_is_refused(blob_dataset: Path, tmp_path: Path) -> None:
    train.main(words(blob_dataset, tmp_path, "epochs=1"))
    with pytest.raises(InputError, match="other settings"):
        train.main(words(blob_dataset, tmp_path, "epochs=1", "optim.weight_decay=0.01"))


@pytest.mark.parametrize(("word", "message"), [
    ("epochs=0", "epochs"),
    ("optim.schedule=steps", "schedule"),
    ("device=tpu", "device"),
    ("optim.batch_size=1000", "batch"),
    ("data=/nowhere", "no dataset"),
    ("model.backbone=vgg99", "backbone"),
    ("views=old", "stored, cached, fresh"),
    ("orientations_per_epoch=3", "2 stored ones"),
    ("colour=red", "colour"),
    ("experiment=cpu_smal", "cpu_smal"),
    ("sensor.strength=much", "strength"),
    ("workers=-1", "workers"),
    ("seed=-1", "seed"),
    ("optim.weight_decay=-0.1", "weight_decay"),
    ("optim.decay=-2", "decay"),
    ("optim.ratio_weight=-1", "ratio_weight"),
])
def test_bad_settings_are_one_line(
    blob_dataset: Path, tmp_path: Path, word: str, message: str
) -> None:
    with pytest.raises(InputError, match=message) as caught:
        train.main(words(blob_dataset, tmp_path / "out", word))
    assert "\n" not in str(caught.value)


def test_drapes_without_views_are_trained_on_with_fresh_ones(
    cloth_dataset: Path, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match="views=fresh"):
        train.main(words(cloth_dataset, tmp_path))
    train.main(words(cloth_dataset, tmp_path, "views=fresh", "epochs=1"))
    content = read_header(tmp_path / "drapenet").content
    assert content["config"]["views"] == "fresh"
    assert content["dataset"]["training_drapes"] < 40


def test_validation_sees_the_same_pictures_every_epoch(cloth_dataset: Path) -> None:
    config = TrainConfig(data=str(cloth_dataset), views="fresh", workers=0)
    config.optim.batch_size = 16
    training, validation, _ = open_splits(config)
    for drapes, moves in ((training, True), (validation, False)):
        drapes.set_epoch(0)
        before = drapes.__getitems__([1])[0]
        drapes.set_epoch(1)
        assert torch.equal(drapes.__getitems__([1])[0], before) != moves


def test_a_file_in_the_way_is_one_line(blob_dataset: Path, tmp_path: Path) -> None:
    (tmp_path / "out").write_text("not a folder")
    with pytest.raises(InputError, match="cannot write to the folder"):
        train.main(words(blob_dataset, tmp_path / "out"))


def test_a_training_that_diverges_is_no_checkpoint(blob_dataset: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"smaller optim\.learning_rate"):
        train.main(words(blob_dataset, tmp_path, "epochs=3", "optim.learning_rate=1e30"))
    assert not (tmp_path / "drapenet.safetensors").exists()


def test_defaults_are_the_papers() -> None:
    config = compose_config("train", [], schema=TrainConfig)
    optim = config.optim
    assert (optim.learning_rate, optim.weight_decay, optim.batch_size, optim.decay) == (
        1e-4, 1e-4, 128, 0.995)
    assert (optim.schedule, config.validation_fraction) == ("exponential", 0.2)


@pytest.mark.parametrize(
    "words", [[], ["experiment=cpu_small"], ["experiment=cpu_small_finish"]])
def test_training_sees_noise_as_calm_as_the_published_captures(words: list[str]) -> None:
    config = OmegaConf.to_object(compose_config("train", words, schema=TrainConfig))
    assert sensor_from_config(config.sensor) == load_sensor("smooth")


def test_the_bundled_experiment_composes() -> None:
    config = compose_config("train", ["experiment=cpu_small"], schema=TrainConfig)
    assert config.optim.schedule == "one_cycle"
    assert config.views == "cached" and config.model.input_width < 120
    for name in ("finish", "more"):
        after = compose_config("train", [f"experiment=cpu_small_{name}"], schema=TrainConfig)
        assert after.model == config.model  # or it could not go on from the other's weights
        assert after.validation_fraction == config.validation_fraction  # or its fabrics mix


def test_the_papers_rate_decays_each_epoch() -> None:
    optim = OptimConfig()
    rates = [learning_rate(optim, epoch=epoch, progress=0.9) for epoch in (0, 1, 100)]
    assert rates == pytest.approx([1e-4, 1e-4 * 0.995, 1e-4 * 0.995**100])


def test_one_cycle_rises_falls_and_ends_with_nothing() -> None:
    optim = OptimConfig(schedule="one_cycle", learning_rate=1e-3, warm_up=0.2)
    rates = [learning_rate(optim, epoch=0, progress=i / 100) for i in range(101)]
    assert max(rates) == rates[20] == pytest.approx(1e-3)
    assert rates[0] == pytest.approx(4e-5) and rates[100] == pytest.approx(0, abs=1e-12)
    assert (np.diff(rates[:21]) > 0).all()
    assert (np.diff(rates[20:]) < 0).all()


def test_mirrored_and_turned_samples_keep_their_labels_in_step(tmp_path: Path) -> None:
    data = write_dataset(tmp_path / "dataset", drapes=20, turn=0.2)
    config = TrainConfig(data=str(data), views="cached", orientations_per_epoch=2, workers=0)
    config.sensor, config.optim.batch_size = {"strength": 0.0}, 16
    config.model.input_width, config.model.input_height = 80, 60
    training, _, _ = open_splits(config)
    drapes, form = training.drapes, config.model.form
    theta = drapes.theta[0].astype(float)
    psi, turns = drapes.orientations[0, 0], drapes.turns[0, 0]
    shown = {}
    for first, mirror in ORDERS:
        views = reorder_views(blob_views(theta, psi, turns), first=first, mirror=mirror)
        # What the first picture shows, read off the table.
        angle = psi + first * np.pi / 2 + turns[first]
        shown[first, mirror] = prepare(torch.from_numpy(views), form=form), angle * (1 - 2 * mirror)
    seen = set()
    for epoch in range(12):
        training.set_epoch(epoch)
        views, targets, axis = (part[0] for part in training.__getitems__([0]))
        order = min(shown, key=lambda o: (views - shown[o][0]).abs().mean())
        expected, angle = shown[order]
        assert (views - expected).abs().mean() < 0.01
        found = torch.atan2(axis[1], axis[0]).item() / 2
        found += 0 if theta[0] > theta[2] else np.pi / 2  # from the stiff axis to the warp
        assert abs((found - angle + np.pi / 2) % np.pi - np.pi / 2) < 1e-3
        assert torch.equal(targets, training.__getitems__([0])[1][0])
        seen.add(order)
    assert len(seen) > 4
