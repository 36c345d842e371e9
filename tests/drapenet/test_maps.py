"""Captures of drapes as maps, and the neighbours of a drape."""

from pathlib import Path

import numpy as np
import pytest

from common.errors import InputError
from data.fabrics import to_theta
from data.nuisances import Nuisances
from data.setups import Setups
from drapenet.maps import make_maps, maps_of_shard
from drapenet.neighbours import change, moves
from sim.drape import drape
from sim.laws import Laws
from sim.material import MICRO, Fabric
from sim.scene import Rig
from sim.sensitivity import follow

SETUPS = Setups.load()


@pytest.fixture(scope="module")
def files(cloth_dataset: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("maps")
    make_maps(cloth_dataset, out, rig=Rig(), setups=SETUPS, captures=1, seed=3, workers=2)
    return out


def test_files_do_not_depend_on_workers_or_interruptions(files: Path, cloth_dataset: Path) -> None:
    folder, = files.iterdir()
    made = sorted(folder.iterdir())
    bytes_of = {file: file.read_bytes() for file in made}
    made[1].unlink()
    maps = make_maps(cloth_dataset, files, rig=Rig(), setups=SETUPS, captures=1, seed=3)
    assert {file: file.read_bytes() for file in sorted(folder.iterdir())} == bytes_of
    assert len(maps) == 40 and not maps.moved.any()
    assert np.isfinite(maps.distance).all() and (maps.weight.max(axis=(1, 2)) > 0).all()


def test_other_settings_have_other_files(files: Path, cloth_dataset: Path) -> None:
    before = set(files.iterdir())
    shard = next(cloth_dataset.glob("shard_*.h5"))
    maps = maps_of_shard(shard, rig=Rig(), setups=SETUPS, captures=2, seed=4, neighbours=False)
    assert len(maps) == 2 * len(np.unique(maps.index))
    assert not np.array_equal(maps.distance[0], maps.distance[1])
    assert set(files.iterdir()) == before


def test_an_unfinished_dataset_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="not a dataset"):
        make_maps(tmp_path, tmp_path / "out", rig=Rig(), setups=SETUPS, captures=1, seed=0)


def test_moves_are_the_derivatives_of_a_stored_drape() -> None:
    """Against the equilibrium next to it of cloth with a stiffer bias or membrane."""
    def cloth(alpha_bias: float, membrane: float) -> tuple[Fabric, Laws]:
        alpha, beta = np.array([30.0, alpha_bias, 25.0]), np.array([-60.0, -50.0, -40.0])
        return (Fabric(alpha * MICRO, beta * 1e-9),
                Nuisances(membrane=membrane, shear=0.5, friction=5e-5).laws)

    fabric, laws = cloth(20.0, 300.0)
    one = drape(fabric, edge=3e-3, seed=1, laws=laws)
    row = {"theta": to_theta(fabric.alpha, fabric.beta), "edge": 3e-3, "seed": 1,
           "offset": (0.0, 0.0),
           "nuisances": Nuisances(membrane=300.0, shear=0.5, friction=5e-5).vector}
    found = moves(row, one.positions.round(5), Rig())
    for changed, predicted in (
        (cloth(20.4, 300.0), found[1] * np.log(1.02) - found[4] * 50e-9 / 20e-6 * (1 / 1.02 - 1)),
        (cloth(20.0, 330.0), found[6] * np.log(1.1)),
    ):
        moved = follow(one, changed[0], laws=changed[1]).positions - one.positions
        assert np.linalg.norm(predicted - moved) < 0.1 * np.linalg.norm(moved)


def test_neighbours_have_the_fabrics_mean_and_covariance() -> None:
    rng = np.random.default_rng(0)
    fabrics = rng.normal(size=(3000, 6)) * [1, 0.8, 1, 1e-3, 1e-3, 1e-3] - 11.0
    steps = np.array([change(theta, fabrics, rng) for theta in fabrics])
    moved = fabrics + steps[:, :6]
    assert moved.mean(axis=0) == pytest.approx(fabrics.mean(axis=0), abs=0.02)
    assert moved.std(axis=0) / fabrics.std(axis=0) == pytest.approx(np.ones(6), abs=0.05)
    assert 0.1 < steps[:, 0].std() / fabrics[:, 0].std() < 0.4
