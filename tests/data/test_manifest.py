"""Where a dataset comes from: what its manifest says of it, and what its hash does not cover."""

import json

import pytest
from test_generate import generate, shards, small_config

import data.dataset.folder
from common.provenance import environment, release
from data.dataset.manifest import json_digest, read_manifest


def elsewhere():
    """Another machine with other versions."""
    return environment() | {"processor": "Z80", "packages": {"numpy": "9.9.9"}}


@pytest.fixture(scope="module")
def here(tmp_path_factory):
    folder = tmp_path_factory.mktemp("here") / "set"
    return folder, generate(folder, small_config(drapes=6))


def test_the_manifest_says_where_the_dataset_comes_from(here):
    folder, manifest = here
    assert manifest == read_manifest(folder)
    assert manifest["provenance"] == [environment()]
    assert manifest["provenance"][0]["code"]["release"] == release()
    assert manifest["config"]["sampling"]["seed"] == 0
    assert manifest["prior"] == {"kind": small_config().prior.kind,
                                 "sha256": json_digest(manifest["config"]["prior"])}


def test_no_digest_depends_on_the_environment(here, tmp_path, monkeypatch):
    monkeypatch.setattr(data.dataset.folder, "environment", elsewhere)
    manifest = generate(tmp_path, small_config(drapes=6))
    assert manifest["provenance"] == [elsewhere()]
    assert manifest | {"provenance": here[1]["provenance"]} == here[1]
    for there, path in zip(shards(tmp_path), shards(here[0]), strict=True):
        assert there.read_bytes() == path.read_bytes()


def test_every_environment_that_made_shards_is_named_once(tmp_path, monkeypatch):
    generate(tmp_path, small_config(drapes=4))
    monkeypatch.setattr(data.dataset.folder, "environment", elsewhere)
    assert generate(tmp_path, small_config(drapes=4))["provenance"] == [environment()]
    for drapes in (6, 8):
        manifest = generate(tmp_path, small_config(drapes=drapes))
        assert manifest["provenance"] == [environment(), elsewhere()]
    assert json.loads((tmp_path / "dataset.json").read_text(encoding="utf-8")) == manifest
