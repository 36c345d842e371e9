import numpy as np
import pytest
from test_generate import generate, small_config

from common.errors import InputError
from data.dataset.manifest import finished_manifest, read_manifest, write_manifest
from data.dataset.splits import split_by_fabric

FRACTIONS = {"train": 0.8, "validation": 0.1, "test": 0.1}


def test_split_is_stable_and_has_its_fractions():
    names = split_by_fabric(np.arange(5000), fractions=FRACTIONS)
    for name, fraction in FRACTIONS.items():
        assert abs((names == name).mean() - fraction) < 0.02
    some = split_by_fabric(np.array([7, 3, 7]), fractions=FRACTIONS)
    np.testing.assert_array_equal(some, names[[7, 3, 7]])
    with pytest.raises(InputError, match="add up"):
        split_by_fabric(np.arange(3), fractions={"train": 0.5, "test": 0.4})


def test_no_dataset_or_an_unfinished_one(tmp_path):
    root, copy = tmp_path / "set", tmp_path / "copy"
    copy.mkdir()
    manifest = generate(root, small_config(drapes=4))
    assert finished_manifest(root) == manifest
    with pytest.raises(InputError, match="not a dataset"):
        finished_manifest(copy)
    write_manifest(copy, manifest | {"complete": False})
    with pytest.raises(InputError, match="unfinished"):
        finished_manifest(copy)
    manifest = read_manifest(root)
    manifest["config"]["sampling"]["drift"] = 0.004
    write_manifest(copy, manifest)
    with pytest.raises(InputError, match="do not match its content"):
        finished_manifest(copy)
