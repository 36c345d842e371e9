"""train.py as a user runs it: it learns, and an interruption changes nothing."""

import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from cloths import write_dataset
from words import last

import train
from common.command import compose_config
from common.errors import InputError
from data.dataset.folder import finished_manifest
from data.render.setups import Setups
from drapenet.config import ModelConfig, OptimConfig, TrainConfig
from drapenet.network import model
from drapenet.network import training as steps
from drapenet.network.captures import CaptureSet, Condition, stated_errors
from drapenet.network.checkpoint import read_header
from drapenet.network.dataset import Maps
from drapenet.network.evaluate import DEPTH, OUTLINE
from drapenet.network.model import Network, make_network
from drapenet.network.optimizer import Optimizer
from drapenet.network.training import (
    describe,
    fit,
    learning_rate,
    load_state,
    open_captures,
    validate,
)
from drapenet.network.weights import load_model
from drapenet.views.directions import AZIMUTHS, ELEVATIONS
from drapenet.views.outline import PERSPECTIVES
from drapenet.views.radial_map import compressed
from sim.rig import DISC_RIG

SMALL = ["model.width=4", "optim.batch_size=8", "threads=1", "workers=1", "device=cpu", "seed=3",
         "captures=2", "neighbours=false", "validation_fraction=0.2", "optim.learning_rate=0.003",
         "epochs=2", "graphs=false",
         *(f"setup.sensors.{name}=0" for name in ("smooth", "paper", "tof")),
         "+setup.sensors.none=1"]  # captures without noise cost less


@pytest.fixture(scope="module", autouse=True)
def few_features() -> Iterator[None]:
    """Networks of small layers, whose steps cost less."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(model, "_EMBEDDING", 32)
        yield


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
    for state in (whole, resumed):
        state["moments"] = [part["state"] for part in state["optimizer"]["parts"]]
    for part in ("model", "moments"):
        torch.testing.assert_close(whole[part], resumed[part], rtol=0, atol=0)
    first, second = (run / "drapenet.safetensors" for run in (trained, tmp_path))
    assert first.read_bytes() == second.read_bytes()


def test_an_extended_training_is_the_same_however_it_was_interrupted(
    words, trained, tmp_path, monkeypatch
):
    """From two epochs to three: after the second, or decided within it; and interrupted again."""
    whole, broken = tmp_path / "whole", tmp_path / "broken"
    shutil.copytree(trained, whole)
    train.main(last(*words, f"out={whole}", "epochs=3"))
    rates = []

    def interrupt(*args: object) -> float:
        rates.append(learning_rate(*args))
        if len(rates) in (4, 7):  # within the second epoch, and the third
            raise KeyboardInterrupt
        return rates[-1]

    monkeypatch.setattr(steps, "learning_rate", interrupt)
    for epochs in (2, 3):
        with pytest.raises(KeyboardInterrupt):
            train.main(last(*words, f"out={broken}", f"epochs={epochs}"))
    train.main(last(*words, f"out={broken}", "epochs=3"))
    first, second = (torch.load(run / "state.pt") for run in (whole, broken))
    assert first["record"] == second["record"] and first["record"]["cycles"] == [2, 3]
    torch.testing.assert_close(first["model"], second["model"], rtol=0, atol=0)
    # The rate has fallen at the end of the second epoch, and rises again.
    assert rates[-2] == learning_rate(compose_config("train", words, schema=TrainConfig).optim, 0.0)
    before = torch.load(trained / "state.pt")
    assert not torch.equal(before["model"]["stem.0.weight"], first["model"]["stem.0.weight"])


def test_a_training_begins_with_the_weights_of_a_checkpoint(words, trained, tmp_path):
    start = trained / "drapenet.safetensors"
    begun = last(*words, f"start={start}", "optim.learning_rate=1e-12", "epochs=1",
                 f"out={tmp_path / 'begun'}", "fabrics=12", "seed=9")
    train.main(begun)
    first, second = (read_header(folder / "drapenet.safetensors")
                     for folder in (trained, tmp_path / "begun"))
    # Also the unit of the distances, which those of two drapes would give otherwise.
    assert first.targets == second.targets and first.model == second.model
    weights = [dict(load_model(header).named_parameters()) for header in (first, second)]
    for name, value in weights[0].items():
        assert torch.allclose(value, weights[1][name], atol=1e-3), name
    with pytest.raises(InputError, match=r"contains a training with other settings.*start"):
        train.main(last(*[word for word in begun if not word.startswith("start=")]))
    with pytest.raises(InputError, match=r"start=.* has a network of width=4.* ask for 8"):
        train.main(last(*begun, "model.width=8", f"out={tmp_path / 'other'}"))


def test_a_training_is_not_shortened(words, trained, tmp_path):
    shutil.copy(trained / "state.pt", tmp_path)
    with pytest.raises(InputError, match="epochs=1: this training is one of 2; give as many"):
        train.main(last(*words, f"out={tmp_path}", "epochs=1"))


def test_a_checkpoint_describes_its_training(trained, cloth_dataset):
    header = read_header(trained / "drapenet.safetensors")
    assert header.dataset.sha256 == [finished_manifest(cloth_dataset)["hash"]]
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
    ("optim.batch_size=1000", "batch"),
    ("model.backbone=resnet18", r"inputs=\[depth,outline,numbers\].*give inputs=\[depth\]"),
    ("setup.pitch_deg=[50,25]", "pitch"),
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
    assert len(training) + len(unseen) == 24 and len(training) // 8 == 2
    first, again = (next(training.epoch(seed=1, epoch=2, size=8)) for _ in range(2))
    other = next(training.epoch(seed=1, epoch=3, size=8))
    assert np.array_equal(first.distance, again.distance)
    assert not np.array_equal(first.distance, other.distance)


def test_the_first_fabrics_or_a_tester_are_learned(tmp_path):
    testers = ("square300_cylinder100", "disc240_support180")
    folder = write_dataset(tmp_path / "set", drapes=24, seed=8, starts=("sine",), testers=testers)
    few = [f"data={folder}", f"maps={tmp_path / 'maps'}", *SMALL, "optim.batch_size=4"]
    (every, unseen, _), (first, same, _), (squares, _, described) = [
        open_captures(compose_config("train", last(*few, *more), schema=TrainConfig))
        for more in ([], ["fabrics=4"], [f"tester={testers[0]}"])]
    assert set(first.maps.fabric) == set(np.unique(every.maps.fabric)[:4])
    assert set(unseen.maps.index) == set(same.maps.index)
    assert set(squares.maps.index) == set(every.maps.index[~every.maps.disc])
    assert described["generation"][0]["sampling"]["testers"] == [testers[0]]


@pytest.mark.parametrize(("inputs", "seen"), [
    ("outline", {"outline"}), ("numbers", {"numbers"}), ("depth,numbers", {"depth", "numbers"})])
def test_a_network_is_trained_on_the_inputs_asked_for_alone(words, inputs, seen):
    config = compose_config("train", [*words, f"inputs=[{inputs}]"], schema=TrainConfig)
    training, _, _ = open_captures(config)
    condition = Condition.of_inputs(config.inputs)
    assert sum(condition.kinds) == pytest.approx(1)
    rng, found = np.random.default_rng(0), set()
    for _ in range(8):
        _, facts = training.batch(np.arange(len(training)), condition, rng)
        deep = facts.views > 0
        counted = ~deep & np.isnan(facts.perspective)
        found |= {"depth"} if deep.any() else set()
        found |= {"numbers"} if np.isfinite(facts.nodes).any() else set()
        found |= {"outline"} if (~deep & ~counted).any() else set()
    assert found == seen


def test_several_datasets_of_other_testers_are_one(words, tmp_path):
    other = write_dataset(tmp_path / "discs", drapes=8, seed=9, testers=(DISC_RIG.name,))
    data = words[0].removeprefix("data=")
    config = compose_config("train", last(*words, f"data=[{data},{other}]"), schema=TrainConfig)
    training, unseen, described = open_captures(config)
    assert len(training) + len(unseen) == 32 and set(training.maps.disc) == {True, False}
    assert len(described["sha256"]) == len(described["generation"]) == 2
    assert training.maps.index.max() > 1 << 39  # their drapes have the same numbers
    older, newest = (part["sampling"] for part in described["generation"])
    older["anisotropy"] = older["nuisances"] = None
    prior = describe(config, training, described, {}, epoch=0, cycles=[1])["prior"]
    assert prior["fabrics"] == described["generation"][-1]["prior"]
    assert prior["nuisances"] == newest["nuisances"] and prior["anisotropy"] == newest["anisotropy"]


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


def stiff_maps(count: int, *, seed: int) -> Maps:
    """Maps and outlines that stand out further where the cloth is stiffer, along warp, bias and
    weft."""
    rng = np.random.default_rng(seed)
    theta = np.column_stack([rng.normal(-11, 0.8, (count, 3)), rng.normal(-2e-3, 1e-3, (count, 3))])
    azimuth = 2 * np.pi * (np.arange(AZIMUTHS) + 0.5) / AZIMUTHS
    yarns, bias = (theta[:, [0]] + theta[:, [2]]) / 2, theta[:, [1]]
    stiffness = ((yarns + bias) / 2 + (theta[:, [0]] - theta[:, [2]]) / 2 * np.cos(2 * azimuth)
                 + (yarns - bias) / 2 * np.cos(4 * azimuth))
    distance = np.repeat(0.3 + 0.03 * (stiffness + 11)[:, :, None], ELEVATIONS, axis=2)
    radius = 0.75 + 0.06 * (stiffness + 11)
    one = np.ones(count)
    return Maps(
        *compressed(distance, np.ones_like(distance)), hem=radius.astype(np.float16),
        silhouettes=np.repeat(radius[:, None], len(PERSPECTIVES), axis=1),
        pictures=np.zeros((count, 0, 0, 0), np.float16), angle=np.zeros(count),
        depth=np.arange(count), theta=theta,
        curl=rng.normal(0, 2, (count, 2)), membrane=rng.lognormal(6, 0.5, count),
        hysteresis=rng.uniform(0.1, 0.3, count), kind=np.zeros(count, int), size=0.3 * one,
        plate=0.6 * one, rim=0 * one, disc=one > 0, aspect=one, face=one, views=4 * one,
        folds=7 * one, fabric=np.arange(count), index=np.arange(count), moved=one < 0)


def learned(
    training: CaptureSet, unseen: CaptureSet, condition: Condition, *, epochs: int,
    rate: float = OPTIM.learning_rate, **layers: object
) -> tuple[Network, CaptureSet]:
    """A network of one Gaussian trained on captures, and the unseen ones in its scale."""
    torch.manual_seed(0)
    network = make_network(**training.network(ModelConfig(components=1, dropout=0.0, **layers)))
    batches = [batch for epoch in range(epochs) for batch in training.epoch(
        seed=0, epoch=epoch, size=OPTIM.batch_size, condition=condition)]
    fit(network, ((step / len(batches), batch) for step, batch in enumerate(batches)),
        optimizer=Optimizer(network, weight_decay=OPTIM.weight_decay),
        optim=replace(OPTIM, learning_rate=rate))
    return network, CaptureSet(unseen.maps, scale=training.scale)


def condition(kinds: tuple[float, float, float], known: float = 1.0) -> Condition:
    return Condition(kinds, (1.0,), known=known, parallel=1.0)


@pytest.mark.parametrize(("output", "epochs", "rate", "seen", "conditions"), [
    ("posterior", 40, 5e-3, condition((0.5, 0.5, 0.0), 0.5), {
        condition(DEPTH): 0.5, condition(DEPTH, 0.0): 0.7, condition(OUTLINE): 0.7}),
    ("regression", 10, 1e-2, condition(DEPTH), {condition(DEPTH): 0.5})])
def test_training_learns_all_three_directions(output, epochs, rate, seen, conditions):
    """Without the directions the errors would be 0.8, without anything 1."""
    network, unseen = learned(CaptureSet(stiff_maps(320, seed=0)),
                              CaptureSet(stiff_maps(128, seed=1)), seen, epochs=epochs, rate=rate,
                              backbone=None, output=output, width=4)
    for shown, most in conditions.items():
        metrics = validate(network, unseen, shown)
        assert metrics["rmse_log_alpha"] < most
        assert 0.85 < metrics["rmse_beta_over_alpha"] < 1.2  # the captures do not show it
        assert 0.4 < metrics["inside"]["68%"] < 0.9


def test_errors_of_outlines_are_as_large_as_it_is_stated():
    off, stated = stated_errors(4000, np.random.default_rng(0), (2e-3, 0.1))
    assert (np.abs(off) < stated).mean() == pytest.approx(0.683, abs=0.02)
    whole = np.ptp(stated, axis=1) == 0
    assert 0.4 < whole.mean() < 0.6 and stated.min() < 1e-3 and stated.max() > 0.08
    # Some are off as a whole.
    together = np.abs(off[whole].mean(axis=1)) / off[whole].std(axis=1)
    assert (together > 3).mean() > 0.1 and (together < 0.3).mean() > 0.1


def test_read_outlines_have_errors_also_in_their_coefficients():
    captures = CaptureSet(stiff_maps(64, seed=0))
    (sound, _), (read, facts) = (captures.batch(
        np.arange(64), replace(condition(OUTLINE), read=share), np.random.default_rng(0),
        symmetric=False) for share in (0, 1))
    assert (read.error > 0).all() and not sound.error.any()
    assert 3e-3 < np.sqrt(np.square(read.outline - sound.outline).mean()) < 0.06
    np.testing.assert_allclose(read.facts[:, 11], facts.columns()[:, 11], atol=1e-6)
    assert np.abs(read.facts[:, 11] - sound.facts[:, 11]).max() > 1e-3


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
