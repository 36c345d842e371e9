import json
import shutil
from pathlib import Path

import pytest
import torch
from safetensors.torch import save_file

from common.errors import InputError
from drapenet.canonical import AZIMUTHS, ELEVATIONS
from drapenet.checkpoint import (
    bundled,
    load_model,
    load_state,
    read_header,
    save_checkpoint,
    save_state,
)
from drapenet.network import KNOWN, MapNet
from sim.scene import DISC_RIG, SMALL_DISC_RIG, SQUARE_RIG, Rig


@pytest.fixture
def checkpoint(untrained_checkpoint: Path, tmp_path: Path) -> Path:
    """A copy that a test may spoil."""
    for suffix in (".safetensors", ".json"):
        shutil.copy(untrained_checkpoint.with_suffix(suffix), tmp_path / f"copy{suffix}")
    return tmp_path / "copy.safetensors"


def edit(checkpoint: Path, **changes: object) -> None:
    file = checkpoint.with_suffix(".json")
    file.write_text(json.dumps(json.loads(file.read_text()) | changes))


@pytest.mark.parametrize("suffix", [".safetensors", ".json", ""])
def test_either_file_or_the_stem_names_a_checkpoint(checkpoint: Path, suffix: str) -> None:
    assert read_header(checkpoint.with_suffix(suffix)).path == checkpoint


@pytest.mark.parametrize("half", [False, True])
def test_a_loaded_network_predicts_the_same(checkpoint: Path, half: bool) -> None:
    content = json.loads(checkpoint.with_suffix(".json").read_text())
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
    with pytest.raises(InputError, match=r"nothing\.safetensors"):
        read_header(tmp_path / "nothing")


@pytest.mark.parametrize(("changes", "message"), [
    ({"schema": "other"}, "schema='other' must be 'drapenet-checkpoint'"),
    ({"schema_version": 99}, "schema_version=99 must be 2; use the program"),
    ({"targets": {"mean": [0], "std": [1]}}, "must have model.targets=6 numbers"),
    ({"targets": {"mean": [0] * 6, "std": [1] * 5 + [0]}},
     r"targets\.std\.5=0 must be more than 0"),
    ({"fabrics": {"low": [0] * 6}}, r"fabrics\.high is missing"),
    ({"model": {"targets": 8}}, r"model\.width is missing"),
    ({"weights": None}, "weights=None is not a mapping"),
    ({"dataset": {"sha256": 3}}, r"dataset\.sha256=3 is not a text"),
    ({"model": {"width": 100000, "components": 2, "targets": 6, "distance": 0.1, "spread": 0.1}},
     r"model\.width=100000 must be at most 512"),
    ({"model": {"width": 8, "targets": 6, "depth": 3}}, r"unknown key 'model\.depth'"),
    ({"config": {"setup": None}}, r"config\.setup=None is not a mapping"),
])
def test_another_schema_is_refused(checkpoint: Path, changes: dict, message: str) -> None:
    edit(checkpoint, **changes)
    with pytest.raises(InputError, match=message) as caught:
        read_header(checkpoint)
    assert "\n" not in str(caught.value)


def test_incomplete_json_is_refused(checkpoint: Path) -> None:
    file = checkpoint.with_suffix(".json")
    file.write_text(file.read_text()[:100])
    with pytest.raises(InputError, match="not a JSON document"):
        read_header(checkpoint)
    file.write_text(json.dumps({"schema": "drapenet-checkpoint", "schema_version": 2}))
    with pytest.raises(InputError, match="rig is missing"):
        read_header(checkpoint)


@pytest.mark.parametrize("text", [
    "[" * 100_000, '{"schema": 1, "schema": 2}', '{"rig": NaN}', "9" * 9999, "\ud800", "[]",
    "null"])
def test_hostile_json_is_refused_in_one_line(checkpoint: Path, text: str) -> None:
    checkpoint.with_suffix(".json").write_bytes(text.encode("utf-8", "surrogatepass"))
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


def test_changed_weights_are_refused(checkpoint: Path) -> None:
    data = bytearray(checkpoint.read_bytes())
    data[-1] ^= 1
    checkpoint.write_bytes(data)
    with pytest.raises(InputError, match="do not belong together"):
        load_model(read_header(checkpoint))


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
    (tmp_path / "state").write_bytes(b"not safetensors")
    model = torch.nn.Linear(1, 1)
    with pytest.raises(InputError, match="cannot be resumed"):
        load_state(tmp_path / "state", run={}, model=model,
                   optimizer=torch.optim.Adam(model.parameters()))


@pytest.mark.parametrize(("record", "tensors", "complaint"), [
    ({"epochs_done": "1"}, {}, "epochs_done='1' is not a whole number"),
    ({"best_loss": []}, {}, r"best_loss=\[\] is not a number"),
    ({"run": None}, {}, "run=None is not a mapping"),
    ({}, {"optimizer.0.exp_avg": torch.zeros(7)}, "moments of parameter 0 are missing"),
    ({}, {"optimizer.x": torch.zeros(1)}, "cannot be resumed"),
])
def test_a_state_of_other_content_is_an_input_error(
    tmp_path: Path, record: dict, tensors: dict, complaint: str
) -> None:
    model = torch.nn.Linear(1, 1)
    content = {"run": {}, "epochs_done": 1, "best_loss": 0.5} | record
    save_file({**{f"model.{name}": value for name, value in model.state_dict().items()}, **tensors},
              tmp_path / "state", metadata={"record": json.dumps(content)})
    with pytest.raises(InputError, match=complaint):
        load_state(tmp_path / "state", run={}, model=model,
                   optimizer=torch.optim.Adam(model.parameters()))
