import json
import shutil
from pathlib import Path

import pytest
import torch

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
    header = read_header(checkpoint)
    torch.manual_seed(5)
    model = MapNet(**header.content["model"]).eval()
    save_checkpoint(checkpoint, model=model, description=header.content, half=half)
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
    ({"schema": "other"}, "does not describe"),
    ({"schema_version": 99}, "schema version 99"),
    ({"targets": {"mean": [0], "std": [1]}}, "not described as expected"),
    ({"targets": {"mean": [0] * 6, "std": [1] * 5 + [0]}}, "not described as expected"),
    ({"fabrics": {"low": [0] * 6}}, "not described as expected"),
    ({"model": {"targets": 8}}, "not described as expected"),
    ({"weights": None}, "not described as expected"),
    ({"dataset": {"sha256": 3}}, "not described as expected"),
])
def test_another_schema_is_refused(checkpoint: Path, changes: dict, message: str) -> None:
    edit(checkpoint, **changes)
    with pytest.raises(InputError, match=message) as caught:
        read_header(checkpoint)
    assert "\n" not in str(caught.value)


def test_incomplete_json_is_refused(checkpoint: Path) -> None:
    file = checkpoint.with_suffix(".json")
    file.write_text(file.read_text()[:100])
    with pytest.raises(InputError, match="cannot read"):
        read_header(checkpoint)
    file.write_text(json.dumps({"schema": "drapenet-checkpoint", "schema_version": 2}))
    with pytest.raises(InputError, match="lacks"):
        read_header(checkpoint)


def test_an_unknown_network_is_refused(checkpoint: Path) -> None:
    edit(checkpoint, model={"width": 8, "targets": 6, "depth": 3})
    with pytest.raises(InputError, match="does not fit the network"):
        load_model(read_header(checkpoint))


@pytest.mark.parametrize("rig", ["square300_cylinder100", "disc300_support180"])
def test_each_tester_has_a_bundled_network(rig: str) -> None:
    header = read_header(bundled(rig))
    assert header.rig == rig
    assert load_model(header).training is False


def test_a_rig_without_a_network_is_named() -> None:
    with pytest.raises(InputError, match="no network is bundled for the rig 'square600"):
        bundled("square600_corners500")


def test_changed_weights_are_refused(checkpoint: Path) -> None:
    data = bytearray(checkpoint.read_bytes())
    data[-1] ^= 1
    checkpoint.write_bytes(data)
    with pytest.raises(InputError, match="not the file that its JSON describes"):
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
    save_state(tmp_path / "state", model=model, optimizer=optimizer, record={"epochs_done": 1})
    other = torch.nn.Linear(3, 2)
    resumed = torch.optim.Adam(other.parameters(), lr=0.1)
    assert load_state(tmp_path / "state", model=other, optimizer=resumed) == {"epochs_done": 1}
    step(model, optimizer)
    step(other, resumed)
    assert torch.equal(model.weight, other.weight)


def test_a_damaged_state_is_an_input_error(tmp_path: Path) -> None:
    (tmp_path / "state").write_bytes(b"not safetensors")
    model = torch.nn.Linear(1, 1)
    with pytest.raises(InputError, match="cannot be resumed"):
        load_state(tmp_path / "state", model=model,
                   optimizer=torch.optim.Adam(model.parameters()))
