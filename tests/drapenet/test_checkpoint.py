import hashlib
import json
import shutil
from pathlib import Path

import pytest
import torch
from checkpoints import change_description, describe_again, description
from safetensors.torch import load, save_file

from common.errors import InputError
from drapenet.network.checkpoint import (
    bundled,
    load_model,
    load_state,
    read_header,
    save_checkpoint,
    save_state,
)
from drapenet.network.model import KNOWN, MapNet
from drapenet.views.radial_map import AZIMUTHS, ELEVATIONS
from sim.rig import DISC_RIG, SMALL_DISC_RIG, SQUARE_RIG, Rig


@pytest.fixture
def checkpoint(untrained_checkpoint: Path, tmp_path: Path) -> Path:
    """A copy that a test may spoil."""
    return Path(shutil.copy(untrained_checkpoint, tmp_path / "copy.safetensors"))


def test_a_checkpoint_is_one_file_with_its_hash(checkpoint: Path) -> None:
    header = read_header(checkpoint)
    assert list(checkpoint.parent.iterdir()) == [checkpoint] == [header.path]
    assert header.sha256 == hashlib.sha256(checkpoint.read_bytes()).hexdigest()


@pytest.mark.parametrize("half", [False, True])
def test_a_loaded_network_predicts_the_same(checkpoint: Path, half: bool) -> None:
    content = description(checkpoint)
    torch.manual_seed(5)
    model = MapNet(**content["model"]).eval()
    save_checkpoint(checkpoint, model=model, description=content, half=half)
    shape = (2, AZIMUTHS, ELEVATIONS)
    maps = [0.08 + 0.02 * torch.rand(shape), torch.rand(shape), torch.zeros(2, KNOWN)]
    with torch.no_grad():
        first, second = (network(*maps).means for network in (model, load_model(
            read_header(checkpoint))))
    assert (first - second).abs().max() <= (2e-2 if half else 0)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"no checkpoint file .*nothing; "):
        read_header(tmp_path / "nothing")


@pytest.mark.parametrize(("changes", "message"), [
    ({"schema_version": 99}, "schema_version=99 must be 3; use the program"),
    ({"targets": {"mean": [0], "std": [1]}}, "must have model.targets=6 numbers"),
    ({"targets": {"mean": [0] * 6, "std": [1] * 5 + [0]}},
     r"targets\.std\.5=0 must be more than 0"),
    ({"fabrics": {"low": [0] * 6}}, r"fabrics\.high is missing"),
    ({"model": {"targets": 8}}, r"model\.width is missing"),
    ({"dataset": {"sha256": 3}}, r"dataset\.sha256=3 is not a text"),
    ({"model": {"width": 100000, "components": 2, "targets": 6, "distance": 0.1, "spread": 0.1}},
     r"model\.width=100000 must be at most 512"),
    ({"model": {"width": 8, "targets": 6, "depth": 3}}, r"unknown key 'model\.depth'"),
    ({"config": {"setup": None}}, r"config\.setup=None is not a mapping"),
])
def test_another_schema_is_refused(checkpoint: Path, changes: dict, message: str) -> None:
    change_description(checkpoint, **changes)
    with pytest.raises(InputError, match=message) as caught:
        read_header(checkpoint)
    assert "\n" not in str(caught.value)


def test_an_incomplete_description_is_refused(checkpoint: Path) -> None:
    describe_again(checkpoint, json.dumps(description(checkpoint))[:100])
    with pytest.raises(InputError, match="not a JSON document"):
        read_header(checkpoint)
    describe_again(checkpoint, json.dumps({"schema_version": 3}))
    with pytest.raises(InputError, match="rig is missing"):
        read_header(checkpoint)
    save_file(load(checkpoint.read_bytes()), checkpoint)
    with pytest.raises(InputError, match="does not describe its network"):
        read_header(checkpoint)


@pytest.mark.parametrize("text", [
    "[" * 100_000, '{"schema": 1, "schema": 2}', '{"rig": NaN}', "9" * 9999, "[]", "null"])
def test_hostile_json_is_refused_in_one_line(checkpoint: Path, text: str) -> None:
    describe_again(checkpoint, text)
    with pytest.raises(InputError) as caught:
        read_header(checkpoint)
    assert str(caught.value).isprintable() and len(str(caught.value)) < 400


@pytest.mark.parametrize("rig", [SQUARE_RIG, DISC_RIG], ids=lambda rig: rig.name)
def test_each_common_tester_has_a_bundled_network(rig: Rig) -> None:
    header = read_header(bundled(rig))
    assert header.rig == rig
    assert load_model(header).training is False


def test_a_tester_without_a_network_is_named_with_those_that_have_one() -> None:
    with pytest.raises(InputError, match="for the tester disc240_support180; the bundled networks "
                       "know disc300_support180 and square300_cylinder100: give checkpoint=FILE"):
        bundled(SMALL_DISC_RIG)


def test_weights_of_another_network_are_refused(checkpoint: Path) -> None:
    change_description(checkpoint, model=description(checkpoint)["model"] | {"width": 16})
    with pytest.raises(InputError, match="does not fit the network"):
        load_model(read_header(checkpoint))


def test_a_truncated_checkpoint_is_refused(checkpoint: Path) -> None:
    checkpoint.write_bytes(checkpoint.read_bytes()[:-1])
    with pytest.raises(InputError, match=r"copy\.safetensors is not a safetensors file"):
        read_header(checkpoint)


def test_state_brings_back_weights_moments_and_record(tmp_path: Path) -> None:
    def step(model: torch.nn.Module, optimizer: torch.optim.Optimizer) -> None:
        optimizer.zero_grad()
        model(torch.ones(2, 3)).square().sum().backward()
        optimizer.step()

    torch.manual_seed(0)
    model = torch.nn.Linear(3, 2)
    optimizer = torch.optim.Adam(model.parameters(), lr=0.1)
    step(model, optimizer)
    record = {"run": {"settings": {}}, "epochs_done": 1, "best_loss": 0.5}
    save_state(tmp_path / "state", model=model, optimizer=optimizer, record=record)
    other = torch.nn.Linear(3, 2)
    resumed = torch.optim.Adam(other.parameters(), lr=0.1)
    assert load_state(
        tmp_path / "state", run={"settings": {}}, model=other, optimizer=resumed) == record
    step(model, optimizer)
    step(other, resumed)
    assert torch.equal(model.weight, other.weight)


def test_a_damaged_state_is_an_input_error(tmp_path: Path) -> None:
    (tmp_path / "state").write_bytes(b"not a state")
    model = torch.nn.Linear(1, 1)
    with pytest.raises(InputError, match="cannot be resumed"):
        load_state(tmp_path / "state", run={}, model=model,
                   optimizer=torch.optim.Adam(model.parameters()))


@pytest.mark.parametrize("content", [[], {}, {"record": {}}, {
    "record": {"run": {}}, "model": torch.nn.Linear(2, 2).state_dict(), "optimizer": {}}])
def test_a_state_of_other_content_is_an_input_error(tmp_path: Path, content: object) -> None:
    torch.save(content, tmp_path / "state")
    model = torch.nn.Linear(1, 1)
    with pytest.raises(InputError, match="cannot be resumed"):
        load_state(tmp_path / "state", run={}, model=model,
                   optimizer=torch.optim.Adam(model.parameters()))


def test_a_state_with_code_is_not_run(tmp_path: Path) -> None:
    class Touch:
        def __reduce__(self) -> tuple:
            return Path.touch, (tmp_path / "touched",)

    torch.save({"record": Touch()}, tmp_path / "state")
    model = torch.nn.Linear(1, 1)
    with pytest.raises(InputError, match="cannot be resumed"):
        load_state(tmp_path / "state", run={}, model=model,
                   optimizer=torch.optim.Adam(model.parameters()))
    assert not (tmp_path / "touched").exists()
