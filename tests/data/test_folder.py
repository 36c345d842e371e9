"""The manifest of a dataset: what it requires, where the dataset comes from, and its splits."""

import json
from dataclasses import replace

import numpy as np
import pytest
from test_generate import generate, shards, small_config

import data.dataset.folder
from common.errors import InputError
from common.files import replace_json
from common.provenance import digest, environment, release
from data.dataset.folder import (
    MANIFEST,
    DatasetFolder,
    finished_manifest,
    read_manifest,
    split_by_fabric,
)

FRACTIONS = {"train": 0.8, "validation": 0.1, "test": 0.1}


def elsewhere():
    """Another machine with other versions."""
    return environment() | {"processor": "Z80", "packages": {"numpy": "9.9.9"}}


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    folder = tmp_path_factory.mktemp("dataset") / "set"
    return folder, generate(folder, small_config(drapes=6))


def test_an_unfinished_or_changed_dataset_is_not_used(dataset, tmp_path):
    root, manifest = dataset
    assert finished_manifest(root) == manifest
    with pytest.raises(InputError, match="not a dataset"):
        finished_manifest(tmp_path)
    changed = read_manifest(root)
    changed["config"]["sampling"]["drift"] = 0.004
    for content, complaint in ((manifest | {"complete": False}, "unfinished"),
                               (changed, "do not match its content")):
        replace_json(tmp_path / MANIFEST, content)
        with pytest.raises(InputError, match=complaint):
            finished_manifest(tmp_path)


def test_the_manifest_says_where_the_dataset_comes_from(dataset):
    folder, manifest = dataset
    assert manifest == read_manifest(folder)
    assert manifest["provenance"] == [environment()]
    assert manifest["provenance"][0]["code"]["release"] == release()
    assert manifest["config"]["sampling"]["seed"] == 0
    assert manifest["prior"] == {"kind": small_config().prior.kind,
                                 "sha256": digest(manifest["config"]["prior"])}


def test_every_environment_that_made_shards_is_named_once(dataset, tmp_path, monkeypatch):
    generate(tmp_path, small_config(drapes=4))
    monkeypatch.setattr(data.dataset.folder, "environment", elsewhere)
    assert generate(tmp_path, small_config(drapes=4))["provenance"] == [environment()]
    for drapes in (6, 8):
        manifest = generate(tmp_path, small_config(drapes=drapes))
        assert manifest["provenance"] == [environment(), elsewhere()]
        if drapes == 6:  # no digest depends on it
            assert manifest | {"provenance": dataset[1]["provenance"]} == dataset[1]
            for there, path in zip(shards(tmp_path), shards(dataset[0]), strict=True):
                assert there.read_bytes() == path.read_bytes()
    assert json.loads((tmp_path / MANIFEST).read_text(encoding="utf-8")) == manifest


def test_another_simulator_neither_resumes_nor_extends_a_dataset(tmp_path, monkeypatch):
    """Its drapes would be mixed with those of the first."""
    generate(tmp_path / "begun", small_config(drapes=8), part=1, parts=2)
    manifest = generate(tmp_path / "finished", small_config(drapes=8))
    monkeypatch.setattr(data.dataset.config, "VERSION", 0)
    for folder in (tmp_path / "begun", tmp_path / "finished"):
        kept = {path: path.read_bytes() for path in folder.iterdir()}
        for drapes in (8, 12):
            with pytest.raises(InputError, match=r"another version of the simulator.*"
                                                 r"finish it with that version") as refusal:
                generate(folder, small_config(drapes=drapes))
            assert "\n" not in str(refusal.value)
        assert kept == {path: path.read_bytes() for path in folder.iterdir()}
    assert finished_manifest(tmp_path / "finished") == manifest


def test_a_device_makes_another_dataset_and_is_recorded(tmp_path):
    """Its drapes equal those of the CPU up to rounding, which may choose other folds."""
    config = small_config(drapes=6, starts=("lowered",))
    cpu, batched, cuda, second = (DatasetFolder(tmp_path, replace(config, device=device))
                                  for device in (None, "cpu", "cuda", "cuda:1"))
    assert cuda.identity == second.identity
    assert len({folder.identity for folder in (cpu, batched, cuda)}) == 3
    batched.begin()
    assert read_manifest(tmp_path)["provenance"] == [environment() | {"device": "cpu"}]
    with pytest.raises(InputError, match=r"other settings \(solver\.device\)"):
        cpu.claim()


def test_splits_are_stable_and_have_their_fractions():
    names = split_by_fabric(np.arange(5000), fractions=FRACTIONS)
    for name, fraction in FRACTIONS.items():
        assert abs((names == name).mean() - fraction) < 0.02
    some = split_by_fabric(np.array([7, 3, 7]), fractions=FRACTIONS)
    np.testing.assert_array_equal(some, names[[7, 3, 7]])
