import hashlib
import shutil
from pathlib import Path

import pytest
import torch
from checkpoints import change_description, describe_again, description
from safetensors.torch import load, save_file

from common.errors import InputError
from drapenet.network.checkpoint import BUNDLED, load_model, read_header, save_checkpoint
from drapenet.network.expected import SHAPE
from drapenet.network.model import ASPECTS, FACTS, Batch, make_network
from drapenet.views.directions import AZIMUTHS, ELEVATIONS


@pytest.fixture
def checkpoint(untrained_checkpoint, tmp_path) -> Path:
    """A copy that a test may spoil."""
    return Path(shutil.copy(untrained_checkpoint, tmp_path / "copy.safetensors"))


def test_a_checkpoint_is_one_file_with_its_hash(checkpoint):
    header = read_header(checkpoint)
    assert list(checkpoint.parent.iterdir()) == [checkpoint] == [header.path]
    assert header.sha256 == hashlib.sha256(checkpoint.read_bytes()).hexdigest()


@pytest.mark.parametrize("half", [False, True])
def test_a_loaded_network_predicts_the_same(checkpoint, half):
    content = description(checkpoint)
    torch.manual_seed(5)
    model = make_network(**content["model"]).eval()
    save_checkpoint(checkpoint, model=model, description=content, half=half)
    shape = (2, AZIMUTHS, ELEVATIONS)
    batch = Batch(0.3 + 0.1 * torch.rand(shape), torch.rand(shape), torch.rand(shape[:2]),
                  torch.ones(2), torch.zeros(2, FACTS + ASPECTS), torch.tensor([0, 0]),
                  torch.zeros(2, 0, 0, 0), torch.zeros(2), torch.zeros(2, SHAPE))
    with torch.no_grad():
        first, second = (batch.through(network).means for network in (model, load_model(
            read_header(checkpoint))))
    assert (first - second).abs().max() <= (2e-2 if half else 0)


@pytest.mark.parametrize(("changes", "message"), [
    ({"schema_version": 99}, "schema_version=99.*use the program"),
    ({"targets": {"mean": [0], "std": [1]}}, "targets.mean"),
    ({"targets": {"mean": [0] * 10, "std": [1] * 9 + [0]}}, r"targets\.std\.9=0"),
    ({"fabrics": {"low": [0] * 6}}, r"fabrics\.high is missing"),
    ({"model": {"components": 2}}, r"model\.width is missing"),
    ({"dataset": {"sha256": 3}}, r"dataset\.sha256=3"),
    ({"model": {"width": 100000, "components": 2, "distance": 0.1, "spread": 0.1}},
     r"model\.width=100000"),
    ({"model": {"width": 8, "depth": 3}}, r"unknown key 'model\.depth'"),
    ({"config": {"setup": None}}, r"config\.setup=None"),
])
def test_another_schema_is_refused(checkpoint, changes, message):
    change_description(checkpoint, **changes)
    with pytest.raises(InputError, match=message) as caught:
        read_header(checkpoint)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("text", [
    '{"schema_version": 3', '{"schema_version": 3}', "[" * 100_000, '{"schema": 1, "schema": 2}',
    '{"rig": NaN}', "9" * 9999, "[]"])
def test_a_damaged_description_is_refused_in_one_line(checkpoint, text):
    describe_again(checkpoint, text)
    with pytest.raises(InputError) as caught:
        read_header(checkpoint)
    assert str(caught.value).isprintable() and len(str(caught.value)) < 400


@pytest.mark.parametrize(("fault", "message"), [
    ("missing", "no checkpoint file"), ("truncated", "not a safetensors file"),
    ("undescribed", "does not describe its network")])
def test_a_file_that_is_no_checkpoint_is_refused(checkpoint, fault, message):
    data = checkpoint.read_bytes()
    checkpoint.unlink()
    if fault == "truncated":
        checkpoint.write_bytes(data[:-1])
    if fault == "undescribed":
        save_file(load(data), checkpoint)
    with pytest.raises(InputError, match=message):
        read_header(checkpoint)


@pytest.mark.skipif(not BUNDLED.exists(), reason="no network is bundled")
def test_the_bundled_network_is_sound():
    assert load_model(read_header()).training is False


def test_weights_of_another_network_are_refused(checkpoint):
    change_description(checkpoint, model=description(checkpoint)["model"] | {"width": 16})
    with pytest.raises(InputError, match="does not fit the network"):
        load_model(read_header(checkpoint))
