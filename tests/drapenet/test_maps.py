"""Captures of drapes as maps, and the neighbours of a drape."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from cloths import skirt, write_dataset

from common.errors import InputError
from data.dataset.config import DatasetConfig, SamplingConfig
from data.dataset.folder import finished_manifest
from data.dataset.generate import generate_dataset
from data.dataset.shards import MOVED_BY, Shard, to_moves
from data.fabrics.nuisances import Nuisances
from data.fabrics.prior import load_prior
from data.render.setups import Setups
from drapenet.network import dataset
from drapenet.network.captures import CaptureSet
from drapenet.network.dataset import make_maps, maps_of_shard, neighbour
from drapenet.views.pictures import SIDE
from sim.draping import drape, follow
from sim.material import MICRO, Fabric
from sim.rig import SMALL_DISC_RIG, SQUARE_RIG
from sim.sensitivity import sensitivities

SETUPS = replace(Setups.load(), sensors={"none": 1.0})  # costs least
FABRIC = Fabric(np.array([30.0, 20.0, 25.0]) * MICRO, np.array([-60.0, -50.0, -40.0]) * 1e-9)


@pytest.fixture(scope="module")
def files(cloth_dataset, tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("maps")
    make_maps(cloth_dataset, finished_manifest(cloth_dataset), out, setups=SETUPS, captures=1,
              seed=3, workers=2, shards=2)
    return out


def test_files_do_not_depend_on_workers_or_interruptions(files, cloth_dataset):
    folder, = files.iterdir()
    made = sorted(folder.iterdir())
    bytes_of = {file: file.read_bytes() for file in made}
    sorted(folder.glob("*.json"))[1].unlink()
    maps = make_maps(cloth_dataset, finished_manifest(cloth_dataset), files, setups=SETUPS,
                     captures=1, seed=3, shards=2)
    assert {file: file.read_bytes() for file in sorted(folder.iterdir())} == bytes_of
    assert len(maps) == 16 and not maps.moved.any()
    assert np.isfinite(maps.distance).all() and (maps.weight.max(axis=(1, 2)) > 0).all()


def test_maps_of_an_extended_dataset_are_those_of_all_its_drapes(tmp_path):
    folder = tmp_path / "set"
    for drapes in (6, 8):
        config = DatasetConfig(drapes, SamplingConfig(), load_prior("gaussian"), edge=0.012,
                               drapes_per_shard=4)
        manifest = generate_dataset(config, folder, solver=skirt)
        maps = make_maps(folder, manifest, tmp_path / "maps", setups=SETUPS, captures=1, seed=3)
        assert maps.index.tolist() == list(range(drapes))
    made, = (tmp_path / "maps").iterdir()
    assert len(list(made.glob("*.npz"))) == 3  # those of the first shard once


def test_another_version_makes_maps_again(files, cloth_dataset, tmp_path, monkeypatch, capsys):
    copy = shutil.copytree(files, tmp_path / "maps")
    for version, made in ((dataset.VERSION, False), (-1, True), (-1, False)):
        monkeypatch.setattr(dataset, "VERSION", version)
        make_maps(cloth_dataset, finished_manifest(cloth_dataset), copy, setups=SETUPS, captures=1,
                  seed=3, shards=1)
        assert ("1 to go" in capsys.readouterr().out) == made


def test_pictures_are_beside_the_maps_where_they_are_asked_for(files, cloth_dataset, tmp_path):
    manifest = finished_manifest(cloth_dataset)
    plain, seen = (make_maps(cloth_dataset, manifest, folder, setups=SETUPS, captures=1, seed=3,
                             shards=1, pictures=pictures)
                   for folder, pictures in ((files, False), (tmp_path, True)))
    assert plain.pictures.shape[:2] == (8, 0) and seen.pictures.shape == (8, 4, SIDE, SIDE)
    np.testing.assert_array_equal(plain.distance, seen.distance)
    shown = np.isfinite(seen.pictures).mean(axis=(2, 3))
    many = {2: 2, 4: 4, 6: 2, 8: 4}  # others are between quarter turns of the first
    for views, row in zip(seen.views, shown, strict=True):
        assert (row > 0.05).sum() == many.get(views, 1)


def test_maps_of_a_shard_that_is_not_listed_are_refused(cloth_dataset, tmp_path):
    manifest = finished_manifest(cloth_dataset)
    shards = {"shard_00000.h5": manifest["shards"]["shard_00001.h5"]}
    with pytest.raises(InputError, match=r"shard_00000\.h5 differs from dataset\.json") as refusal:
        make_maps(cloth_dataset, manifest | {"shards": shards}, tmp_path, setups=SETUPS,
                  captures=1, seed=3)
    assert "\n" not in str(refusal.value)


def test_captures_of_a_drape_differ(cloth_dataset):
    shard = Shard(next(cloth_dataset.glob("shard_*.h5")))
    maps = maps_of_shard(shard, setups=SETUPS, captures=2, seed=4, neighbours=False, outlines=0)
    assert len(maps) == 2 * len(np.unique(maps.index))
    assert not np.array_equal(maps.distance[0], maps.distance[1])


def test_drapes_of_several_testers_have_depth_captures_and_outlines(tmp_path, monkeypatch):
    rigs = [SQUARE_RIG, SMALL_DISC_RIG]
    folder = write_dataset(tmp_path / "several", drapes=8, seed=2,
                           testers=tuple(rig.name for rig in rigs))
    monkeypatch.setattr(Shard, "moves", lambda shard, row: np.full(
        (7, *shard.mesh(row)[0].shape), 1e-4))
    maps = make_maps(folder, finished_manifest(folder), tmp_path, setups=SETUPS, captures=2,
                     seed=4, neighbours=True, outlines=2)
    sizes = {(rig.specimen_size, rig.plate_diameter / rig.specimen_size) for rig in rigs}
    assert set(zip(maps.size, maps.plate, strict=True)) == sizes and len(maps) == 32
    assert (maps.disc == (maps.size == SMALL_DISC_RIG.specimen_size)).all()
    shadow = maps.views == 0  # outlines only
    assert shadow.sum() == 16 and maps.moved.sum() == 24
    assert sorted(maps.depth[~shadow]) == list(range(16)) and (maps.depth[shadow] == -1).all()
    assert (maps.weight.max(axis=(1, 2)) > 0).all() and np.isfinite(maps.hem).mean() > 0.7
    views = maps.depth_views(np.arange(32), ~shadow)
    assert (views["weight"].max(axis=(1, 2)) > 0).tolist() == (~shadow).tolist()
    assert np.isnan(views["hem"][shadow]).all()
    assert (maps.silhouettes[:, -1] <= maps.silhouettes[:, 0]).all()  # from the lowest camera
    assert len(CaptureSet(maps)) == 8 * 4


def test_moves_are_the_derivatives_of_a_stored_drape():
    """Of a lowered one with hysteresis, against that of cloth with a stiffer bias or membrane."""
    one = drape(FABRIC, edge=6e-3, seed=1, keep=True,
                laws=Nuisances(membrane=300.0, shear=0.5, hysteresis=0.2).laws)
    stored = to_moves(sensitivities(one, parameters=MOVED_BY).positions)
    found = (stored["moves"] * stored["move_units"][:, None]).transpose(1, 0, 2)
    bias = replace(FABRIC, alpha=FABRIC.alpha * [1.0, 1.01, 1.0])
    taut = Nuisances(membrane=301.5, shear=0.5).laws.membrane
    for fabric, laws, predicted in (
        (bias, one.laws,
         found[1] * np.log(1.01) - found[4] * 50e-9 / 20e-6 * (1 / 1.01 - 1)),
        (FABRIC, replace(one.laws, membrane=taut), found[6] * np.log(1.005)),
    ):
        moved = follow(one, fabric, laws=laws).positions - one.positions
        assert np.linalg.norm(predicted - moved) < 0.1 * np.linalg.norm(moved)


def test_neighbours_have_the_fabrics_mean_and_covariance():
    rng = np.random.default_rng(0)
    fabrics = rng.normal(size=(3000, 6)) * [1, 0.8, 1, 1e-3, 1e-3, 1e-3] - 11.0
    steps = np.array([neighbour(theta, fabrics, rng) for theta in fabrics])
    moved = fabrics + steps[:, :6]
    assert moved.mean(axis=0) == pytest.approx(fabrics.mean(axis=0), abs=0.02)
    assert moved.std(axis=0) / fabrics.std(axis=0) == pytest.approx(np.ones(6), abs=0.05)
    assert 0.1 < steps[:, 0].std() / fabrics[:, 0].std() < 0.4
