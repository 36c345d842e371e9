"""Composition: what Hydra accepts, and each of its complaints as one line."""

import pytest

from common.configs import compose_config, group_options, read_config, read_option
from common.errors import InputError
from data.options import Options, config_from_options


def test_groups_and_values_are_overridden():
    config = compose_config("generate", ["dataset=paper", "seed=3"], schema=Options)
    assert config.dataset.starts_per_fabric == 8 and config.dataset.drapes_per_shard == 64
    assert config.seed == 3 and config.drapes == 512


@pytest.mark.parametrize(
    ("name", "word", "complaint"),
    [
        ("generate", "dataset=null", "dataset=null"),
        ("generate", "nuisances=null", "nuisances=null"),
        ("generate", "rig=null", "rig: Incompatible value"),
        ("generate", "dataset=huge", "specimens"),
        ("generate", "=3", "=3"),
        ("generate", "--multirun", "--multirun"),
        ("generate", "out=café", "quotes"),
        ("generate", "out=${nowhere}", "nowhere"),
        ("generate", "colour=red", "unknown key 'colour'; known keys: dataset, drapes, edge_mm"),
        ("generate", "+colour=red", "unknown key 'colour'; known keys: dataset"),
        ("generate", "dataset.colour=red", "configs/dataset"),
        ("generate", "nuisances.colour=red", "configs/nuisances"),
        ("generate", "drapes", "'drapes' is not of the form key=value; known keys: dataset"),
        ("generate", "drapes=1.5", "drapes: Value '1.5' of type 'float'"),
        ("generate", "dataset=[1]", "look at: dataset=[1]"),
        ("generate", "out=", "out= needs the name of a folder"),
        ("train", "out=''", "out= needs the name of a folder"),
        ("train", "colour=red", "known keys: captures, data, device"),
        ("train", "optim.colour=red", "unknown key 'optim.colour'"),
        ("train", "setup=rea", "real"),
    ],
)
def test_complaints_are_one_line_that_names_the_cause(name, word, complaint):
    schema = Options if name == "generate" else None
    with pytest.raises(InputError) as refusal:
        compose_config(name, [word], schema=schema)
    text = str(refusal.value)
    assert complaint in text and "\n" not in text and "Exception" not in text
    assert "_type" not in text and "+" not in text  # classes; the advice to append keys


def test_the_remedy_for_unusual_characters_works():
    config = compose_config("generate", ['out="café 1"'], schema=Options)
    assert config.out == "café 1"


@pytest.mark.parametrize(
    "word",
    ["rig=moon", "~dataset", "~dataset.starts", "dataset.starts=null", "~nuisances.shear",
     "nuisances.cut_deg=wide"],
)
def test_values_that_make_no_sense(word):
    with pytest.raises(InputError) as refusal:
        config_from_options(compose_config("generate", [word], schema=Options))
    assert "\n" not in str(refusal.value)


def test_files_are_read_as_they_stand():
    assert read_option("camera", "square300_cylinder100")["camera"]["width"] == 240
    assert read_config("generate")["drapes"] == 512
    assert "smooth" in group_options("sensor")
    with pytest.raises(InputError, match="unknown sensor 'kinect'; known sensors: none"):
        read_option("sensor", "kinect")
