import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import torch

from common.errors import InputError
from drapenet.checkpoint import load_model, load_state, read_header, save_checkpoint, save_state
from drapenet.model import DrapeNet

ERRORS = {"mean": [0.0] * 6, "slope": [0.0] * 6, "level": -11.0, "covariance": np.eye(6).tolist(),
          "fabrics": 9}


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
    model = DrapeNet().eval()
    save_checkpoint(checkpoint, model=model, description=header.content, half=half)
    views = torch.randn(2, 4, 48, 64, generator=torch.Generator().manual_seed(1))
    with torch.no_grad():
        first, second = model(views), load_model(read_header(checkpoint))(views)
    assert (first - second).abs().max() <= (2e-2 if half else 0)
    assert (checkpoint.stat().st_size < 25e6) == half


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"nothing\.safetensors"):
        read_header(tmp_path / "nothing")


@pytest.mark.parametrize(("changes", "message"), [
    ({"schema": "other"}, "does not describe"),
    ({"schema_version": 99}, "schema version 99"),
    ({"targets": {"names": ["a"], "mean": [0], "std": [1]}}, "not described as expected"),
    ({"weights": None}, "not described as expected"),
    ({"validation": {"rmse": {}}}, "not described as expected"),
    ({"errors": {**ERRORS, "mean": [0.0] * 5}}, "errors are not described as expected"),
    ({"errors": {**ERRORS, "level": None}}, "errors are not described as expected"),
    ({"errors": {**ERRORS, "covariance": (-np.eye(6)).tolist()}}, "symmetric and positive"),
    ({"errors": 0.1}, "errors are not described as expected"),
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
    file.write_text(json.dumps({"schema": "drapenet-checkpoint", "schema_version": 1}))
    with pytest.raises(InputError, match="lacks"):
        read_header(checkpoint)


@pytest.mark.parametrize("changes", [
    {"model": {"backbone": "resnet18", "depth": 3}}, {"input": {"size": 3}}])
def test_an_unknown_network_or_input_is_refused(checkpoint: Path, changes: dict) -> None:
    edit(checkpoint, **changes)
    header = read_header(checkpoint)
    with pytest.raises(InputError):
        load_model(header)
        _ = header.form


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
