"""train.py as a user runs it: it learns, and an interruption changes nothing."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from words import last

import train
from common.command import compose_config
from common.errors import InputError
from data.render.setups import Setups
from drapenet.config import ModelConfig, OptimConfig, TrainConfig
from drapenet.network import training as steps
from drapenet.network.checkpoint import load_model, read_header
from drapenet.network.dataset import Maps
from drapenet.network.model import MapNet
from drapenet.network.training import (
    CaptureSet,
    fit,
    learning_rate,
    load_state,
    open_captures,
    validate,
)
from drapenet.views.directions import AZIMUTHS

SMALL = ["model.width=4", "optim.batch_size=16", "threads=1", "workers=1", "device=cpu", "seed=3",
         "captures=2", "neighbours=false", "validation_fraction=0.2", "optim.learning_rate=0.003",
         "epochs=2", *(f"setup.sensors.{name}=0" for name in ("smooth", "paper", "tof")),
         "+setup.sensors.none=1"]  # captures without noise cost less


@pytest.fixture(scope="module")
def words(cloth_dataset, tmp_path_factory) -> list[str]:
    folder = tmp_path_factory.mktemp("train")
    return [f"data={cloth_dataset}", f"maps={folder / 'maps'}", f"out={folder / 'out'}", *SMALL]


@pytest.fixture(scope="module")
def trained(words) -> Path:
    """Folder of a training of two epochs that nothing interrupted."""
    train.main(words)
    return Path(words[2].removeprefix("out="))


def test_a_resumed_training_ends_bit_for_bit_like_an_uninterrupted_one(
    words, trained, tmp_path, monkeypatch
):
    calls = []

    def interrupt(*args: object) -> float:
        calls.append(None)
        if len(calls) == 4:  # within the second epoch
            raise KeyboardInterrupt
        return learning_rate(*args)

    monkeypatch.setattr(steps, "learning_rate", interrupt)
    broken = last(*words, f"out={tmp_path}")
    with pytest.raises(KeyboardInterrupt):
        train.main(broken)
    monkeypatch.setattr(steps, "learning_rate", learning_rate)
    train.main(last(*broken, "workers=2"))
    whole, resumed = (torch.load(run / "state.pt") for run in (trained, tmp_path))
    assert whole["record"] == resumed["record"] and whole["record"]["epochs_done"] == 2
    for part in ("model", "optimizer"):
        torch.testing.assert_close(whole[part], resumed[part], rtol=0, atol=0)
    first, second = (run / "drapenet.safetensors" for run in (trained, tmp_path))
    assert first.read_bytes() == second.read_bytes()


def test_a_checkpoint_describes_its_training(trained):
    header = read_header(trained / "drapenet.safetensors")
    assert load_model(header).training is False
    assert header.dataset.sha256 == f"{8:064x}"
    assert header.model.width == 4
    assert header.setups.sensors["none"] == 1 and header.setups.pitch == Setups.load().pitch
    assert (np.array(header.fabrics.low) < header.fabrics.high).all()


@pytest.mark.parametrize(("word", "name"), [
    ("optim.weight_decay=0.02", r"optim\.weight_decay"), ("model.width=8", r"model\.width")])
def test_another_setting_in_the_same_folder_is_refused(words, trained, tmp_path, word, name):
    shutil.copy(trained / "state.pt", tmp_path)
    with pytest.raises(InputError, match=rf"other settings \({name}\); choose"):
        train.main(last(*words, f"out={tmp_path}", word))


@pytest.mark.parametrize(("word", "message"), [
    ("epochs=0", "epochs"),
    ("device=tpu", "device"),
    ("optim.batch_size=1000", "batch"),
    ("data=/nowhere", "not a dataset"),
    ("captures=0", "captures"),
    ("setup=nowhere", "nowhere"),
    ("setup.pitch_deg=[50,25]", "pitch"),
    ("workers=0", "workers"),
    ("seed=12345678901234567890123", "seed"),
    ("threads=100000000", "threads"),
    ("model.width=100000", "width"),
    ("optim.weight_decay=-0.1", "weight_decay"),
    ("optim.warm_up=1", "warm_up"),
    (f"out={__file__}", "cannot write to the folder"),
])
def test_bad_settings_are_one_line(words, tmp_path, word, message):
    with pytest.raises(InputError, match=message) as caught:
        train.main(last(*words, f"out={tmp_path}", word))
    assert "\n" not in str(caught.value)


def test_validation_has_other_fabrics_and_epochs_other_orders(words):
    config = compose_config("train", words, schema=TrainConfig)
    training, unseen, _ = open_captures(config)
    assert not set(training.maps.fabric) & set(unseen.maps.fabric)
    assert len(training) + len(unseen) == 48 and len(training) // 16 == 2
    first, again = (next(training.epoch(seed=1, epoch=2, size=16)) for _ in range(2))
    other = next(training.epoch(seed=1, epoch=3, size=16))
    assert torch.equal(first.distance, again.distance)
    assert not torch.equal(first.distance, other.distance)


def test_a_training_that_diverges_leaves_no_checkpoint(words, tmp_path):
    with pytest.raises(InputError, match=r"smaller optim\.learning_rate"):
        train.main(last(*words, f"out={tmp_path}", "optim.learning_rate=1e30", "optim.clip=1e30"))
    assert not (tmp_path / "drapenet.safetensors").exists()


OPTIM = OptimConfig(learning_rate=5e-3, warm_up=0.2, weight_decay=0.01, batch_size=32, clip=5.0)


def test_the_rate_rises_falls_and_ends_at_zero():
    optim = replace(OPTIM, learning_rate=1e-3)
    rates = [learning_rate(optim, i / 100) for i in range(101)]
    assert max(rates) == rates[20] == pytest.approx(1e-3)
    assert rates[0] == pytest.approx(4e-5) and rates[100] == pytest.approx(0, abs=1e-12)
    assert (np.diff(rates[:21]) > 0).all()
    assert (np.diff(rates[20:]) < 0).all()


def stiff_maps(count: int, *, disc: bool, seed: int) -> Maps:
    """Maps that stand out further where the cloth is stiffer, along warp, bias and weft."""
    rng = np.random.default_rng(seed)
    theta = np.column_stack([rng.normal(-11, 0.8, (count, 3)), rng.normal(-2e-3, 1e-3, (count, 3))])
    warp = rng.uniform(0, 2 * np.pi, count) if disc else rng.integers(4, size=count) * np.pi / 2
    azimuth = 2 * np.pi * (np.arange(AZIMUTHS) + 0.5) / AZIMUTHS - warp[:, None]
    yarns, bias = (theta[:, [0]] + theta[:, [2]]) / 2, theta[:, [1]]
    stiffness = ((yarns + bias) / 2 + (theta[:, [0]] - theta[:, [2]]) / 2 * np.cos(2 * azimuth)
                 + (yarns - bias) / 2 * np.cos(4 * azimuth))
    distance = 0.08 + 0.01 * (stiffness + 11)
    distance = np.repeat(distance[:, :, None], 16, axis=2).astype(np.float16)  # enough rows
    nuisances = np.tile([316.0, 1.0, 1e-4, 0, 0, 0, 0, 0], (count, 1))
    return Maps(distance, np.full_like(distance, 22, dtype=np.uint8), theta, warp, nuisances,
                np.full(count, 4), np.arange(count), np.arange(count), np.zeros(count, bool))


@pytest.mark.parametrize(("disc", "epochs", "most"), [(False, 6, 0.5), (True, 14, 0.74)])
def test_training_learns_all_three_directions(disc, epochs, most):
    """Without the directions the errors would be 0.8, without anything 1."""
    training = CaptureSet(stiff_maps(320, disc=disc, seed=0), disc=disc)
    unseen = CaptureSet(stiff_maps(128, disc=disc, seed=1), disc=disc, scale=training.scale)
    torch.manual_seed(0)
    network = MapNet(**training.network(ModelConfig(width=4, components=1)))
    batches = [batch for epoch in range(epochs)
               for batch in training.epoch(seed=0, epoch=epoch, size=OPTIM.batch_size)]
    fit(network, ((step / len(batches), batch) for step, batch in enumerate(batches)),
        optimizer=torch.optim.AdamW(network.parameters(), weight_decay=OPTIM.weight_decay),
        optim=OPTIM)
    metrics = validate(network, unseen)
    assert metrics["rmse_log_alpha"] < most
    assert 0.85 < metrics["rmse_beta_over_alpha"] < 1.2  # the maps do not show it
    assert 0.4 < metrics["inside"]["68%"] < 0.9


class Code:
    """Content that creates a file when it is unpickled."""

    def __init__(self, file: Path) -> None:
        self.file = file

    def __reduce__(self) -> tuple:
        return Path.touch, (self.file,)


@pytest.mark.parametrize("fault", ["damaged", "no record", "another network", "code"])
def test_a_state_that_cannot_be_resumed_is_an_input_error(tmp_path, fault):
    file, touched = tmp_path / "state", tmp_path / "touched"
    network = torch.nn.Linear(2, 2).state_dict()
    contents = {"damaged": "", "no record": {"record": {}}, "code": {"record": Code(touched)},
                "another network": {"record": {"run": {}}, "model": network, "optimizer": {}}}
    torch.save(contents[fault], file)
    if fault == "damaged":
        file.write_bytes(file.read_bytes()[:-9])
    model = torch.nn.Linear(1, 1)
    with pytest.raises(InputError, match="cannot be resumed"):
        load_state(file, run={}, model=model, optimizer=torch.optim.Adam(model.parameters()))
    assert not touched.exists()
