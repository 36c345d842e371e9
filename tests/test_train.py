"""train.py as a user runs it: it learns, and an interruption changes nothing."""

from pathlib import Path

import numpy as np
import pytest
import torch
from words import last

import train
from common.command import compose_config
from common.errors import InputError
from data.render.setups import Setups
from drapenet.config import TrainConfig, learning_rate
from drapenet.network.checkpoint import load_model, read_header
from drapenet.network.training import open_captures

SMALL = ["model.width=4", "optim.batch_size=16", "threads=1", "workers=1", "device=cpu", "seed=3",
         "captures=2", "neighbours=false", "validation_fraction=0.2", "optim.learning_rate=0.003"]


@pytest.fixture(scope="module")
def maps(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where the captures' maps are kept, made once."""
    return tmp_path_factory.mktemp("maps")


@pytest.fixture
def words(cloth_dataset: Path, maps: Path, tmp_path: Path) -> list[str]:
    return [f"data={cloth_dataset}", f"maps={maps}", f"out={tmp_path / 'out'}", *SMALL]


def test_resumed_training_ends_bit_for_bit_like_an_uninterrupted_one(
    words: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, one_thread: None
) -> None:
    train.main([*words, "epochs=3"])
    real, calls = train.learning_rate, []

    def interrupt(*args: object) -> float:
        calls.append(None)
        if len(calls) == 6:  # within the second epoch
            raise KeyboardInterrupt
        return real(*args)

    monkeypatch.setattr(train, "learning_rate", interrupt)
    broken = last(*words, "epochs=3", f"out={tmp_path / 'broken'}")
    with pytest.raises(KeyboardInterrupt):
        train.main(broken)
    monkeypatch.setattr(train, "learning_rate", real)
    train.main(last(*broken, "workers=2"))
    whole, resumed = (torch.load(tmp_path / run / "state.pt") for run in ("out", "broken"))
    assert whole["record"] == resumed["record"]
    for part in ("model", "optimizer"):
        torch.testing.assert_close(whole[part], resumed[part], rtol=0, atol=0)
    first, second = (tmp_path / run / "drapenet.safetensors" for run in ("out", "broken"))
    assert first.read_bytes() == second.read_bytes()


def test_a_checkpoint_describes_itself(words: list[str], tmp_path: Path) -> None:
    train.main([*words, "epochs=1"])
    header = read_header(tmp_path / "out" / "drapenet.safetensors")
    assert load_model(header).training is False
    assert header.dataset.sha256 == f"{8:064x}"
    assert header.model.width == 4
    assert header.setups == Setups.load()
    assert (np.array(header.fabrics.low) < header.fabrics.high).all()


def test_another_setting_in_the_same_folder_is_refused(words: list[str]) -> None:
    train.main([*words, "epochs=1"])
    for word, name in (("optim.weight_decay=0.02", r"optim\.weight_decay"),
                       ("model.width=8", r"model\.width")):
        with pytest.raises(InputError, match=rf"other settings \({name}\); choose"):
            train.main(last(*words, "epochs=1", word))


@pytest.mark.parametrize(("word", "message"), [
    ("epochs=0", "epochs"),
    ("device=tpu", "device"),
    ("optim.batch_size=1000", "batch"),
    ("data=/nowhere", "not a dataset"),
    ("model.width=0", "width"),
    ("captures=0", "captures"),
    ("colour=red", "colour"),
    ("setup=nowhere", "nowhere"),
    ("setup.pitch_deg=[50,25]", "pitch"),
    ("workers=0", "workers"),
    ("seed=-1", "seed"),
    ("seed=12345678901234567890123", "seed"),
    ("threads=100000000", "threads"),
    ("workers=1000000", "workers"),
    ("model.width=100000", "width"),
    ("optim.weight_decay=-0.1", "weight_decay"),
    ("optim.warm_up=1", "warm_up"),
    ("optim.clip=0", "clip"),
])
def test_bad_settings_are_one_line(words: list[str], word: str, message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        train.main(last(*words, word))
    assert "\n" not in str(caught.value)


def test_validation_has_other_fabrics_and_no_neighbours(words: list[str]) -> None:
    config = compose_config("train", words, schema=TrainConfig)
    training, unseen, _ = open_captures(config)
    assert not set(training.maps.fabric) & set(unseen.maps.fabric)
    assert len(training) + len(unseen) == 80
    first, again = (next(training.epoch(seed=1, epoch=2, size=16)) for _ in range(2))
    other = next(training.epoch(seed=1, epoch=3, size=16))
    assert torch.equal(first.distance, again.distance)
    assert not torch.equal(first.distance, other.distance)


def test_a_file_in_the_way_is_one_line(words: list[str], tmp_path: Path) -> None:
    (tmp_path / "out").write_text("not a folder")
    with pytest.raises(InputError, match="cannot write to the folder"):
        train.main(words)


def test_a_training_that_diverges_is_no_checkpoint(words: list[str], tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"smaller optim\.learning_rate"):
        train.main(last(*words, "epochs=3", "optim.learning_rate=1e30", "optim.clip=1e30"))
    assert not (tmp_path / "out" / "drapenet.safetensors").exists()


def test_the_rate_rises_falls_and_ends_with_nothing() -> None:
    words = ["optim.learning_rate=1e-3", "optim.warm_up=0.2"]
    optim = compose_config("train", words, schema=TrainConfig).optim
    rates = [learning_rate(optim, i / 100) for i in range(101)]
    assert max(rates) == rates[20] == pytest.approx(1e-3)
    assert rates[0] == pytest.approx(4e-5) and rates[100] == pytest.approx(0, abs=1e-12)
    assert (np.diff(rates[:21]) > 0).all()
    assert (np.diff(rates[20:]) < 0).all()
