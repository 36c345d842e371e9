import hashlib
import shutil
from pathlib import Path

import pytest
import torch
from checkpoints import change_description, describe_again, description
from safetensors.torch import load, save_file

from common.errors import InputError
from drapenet.network.checkpoint import bundled, load_model, read_header, save_checkpoint
from drapenet.network.model import KNOWN, MapNet
from drapenet.views.directions import AZIMUTHS, ELEVATIONS
from sim.rig import DISC_RIG, SMALL_DISC_RIG, SQUARE_RIG


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
    model = MapNet(**content["model"]).eval()
    save_checkpoint(checkpoint, model=model, description=content, half=half)
    shape = (2, AZIMUTHS, ELEVATIONS)
    maps = [0.08 + 0.02 * torch.rand(shape), torch.rand(shape), torch.zeros(2, KNOWN)]
    with torch.no_grad():
        first, second = (network(*maps).means for network in (model, load_model(
            read_header(checkpoint))))
    assert (first - second).abs().max() <= (2e-2 if half else 0)


@pytest.mark.parametrize(("changes", "message"), [
    ({"schema_version": 99}, "schema_version=99.*use the program"),
    ({"targets": {"mean": [0], "std": [1]}}, "must have model.targets=6 numbers"),
    ({"targets": {"mean": [0] * 6, "std": [1] * 5 + [0]}},
     r"targets\.std\.5=0"),
    ({"fabrics": {"low": [0] * 6}}, r"fabrics\.high is missing"),
    ({"model": {"targets": 8}}, r"model\.width is missing"),
    ({"dataset": {"sha256": 3}}, r"dataset\.sha256=3"),
    ({"model": {"width": 100000, "components": 2, "targets": 6, "distance": 0.1, "spread": 0.1}},
     r"model\.width=100000"),
    ({"model": {"width": 8, "targets": 6, "depth": 3}}, r"unknown key 'model\.depth'"),
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


@pytest.mark.parametrize("rig", [SQUARE_RIG, DISC_RIG], ids=lambda rig: rig.name)
def test_each_common_tester_has_a_bundled_network(rig):
    header = read_header(bundled(rig))
    assert header.rig == rig
    assert load_model(header).training is False


def test_a_tester_without_a_network_is_named_with_those_that_have_one():
    with pytest.raises(InputError, match="for the tester disc240_support180; the bundled networks "
                       "know disc300_support180 and square300_cylinder100: give checkpoint=FILE"):
        bundled(SMALL_DISC_RIG)


def test_weights_of_another_network_are_refused(checkpoint):
    change_description(checkpoint, model=description(checkpoint)["model"] | {"width": 16})
    with pytest.raises(InputError, match="does not fit the network"):
        load_model(read_header(checkpoint))
