import json
import shutil
from dataclasses import replace
from pathlib import Path

import fake_drapes
import numpy as np
import pytest

from common.command import compose_config
from common.errors import InputError
from data.dataset import batches
from data.dataset.config import DatasetConfig, Options, SamplingConfig, config_from_options
from data.dataset.folder import DatasetFolder
from data.dataset.generate import generate_dataset
from data.dataset.plan import plan_drape
from data.dataset.shards import MOVED_BY, Shard
from data.dataset.simulate import make_record
from data.fabrics.prior import load_prior
from sim.draping import drape
from sim.rig import DISC_RIG
from sim.sensitivity import sensitivities
from sim.solver import linear
from sim.solver.linear import PardisoSolver, SparsePattern, available_solvers

ROOT = Path(__file__).parents[2]


def small_config(drapes=10, **sampling):
    return DatasetConfig(
        drapes=drapes,
        sampling=SamplingConfig(**{"starts": ("sine", "fold")} | sampling),
        prior=load_prior("gaussian"),
        edge=0.02,
        drapes_per_shard=4,
    )


def generate(out, config=None, **options):
    options = {"solver": fake_drapes.cone, **options}
    return generate_dataset(config or small_config(), out, **options)


def files(folder):
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir())}


def shards(folder):
    return sorted(folder.glob("shard_*.h5"))


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A folder with a finished dataset, and its manifest."""
    folder = tmp_path_factory.mktemp("generated") / "set"
    return folder, generate(folder)


@pytest.mark.parametrize(("word", "stored"), [("5", 5.0), ("null", None)])
def test_the_identity_of_a_dataset_states_the_edges_of_its_meshes(word, stored):
    """5.0 is that of datasets made before null stood for the simulator's own meshes."""
    options = compose_config("generate", [f"edge_mm={word}"], schema=Options)
    assert config_from_options(options).as_dict()["solver"] == {"edge_mm": stored}


def test_records_hold_the_plan_and_the_drape(finished):
    folder, manifest = finished
    config = small_config()
    assert list(manifest["shards"]) == ["shard_00000.h5", "shard_00001.h5", "shard_00002.h5"]
    assert manifest["complete"] and manifest["drapes"] == 10 and manifest["fabrics"] == 5
    assert 0 <= manifest["rejection_rate"] < 0.2 and manifest["starts"] == {"fold": 5, "sine": 5}
    seen, failures = [], 0
    for name in manifest["shards"]:
        shard = Shard(folder / name)
        for row, index in enumerate(shard.column("index")):
            seen.append(int(index))
            plan = plan_drape(int(index), config=config.sampling, prior=config.prior)
            np.testing.assert_array_equal(shard.column("theta")[row], plan.theta)
            np.testing.assert_array_equal(shard.column("offset")[row], plan.offset)
            assert shard.column("start")[row] == plan.start
            assert shard.column("seed")[row] == plan.seed
            failed = plan.seed % fake_drapes.FAIL_SEED_MODULUS == 0
            failures += failed
            expected = "max_iterations" if failed else "converged"
            assert shard.column("status")[row] == expected
            assert np.isnan(shard.column("drape_coefficient")[row]) == failed
            assert (shard.column("folds")[row] < 0) == failed
            # A failed drape keeps its mesh, for whoever wants to know why.
            assert shard.mesh(row)[0][:, 2].min() < -0.01
    assert seen == list(range(10)) and 0 < failures < 10
    assert manifest["outcomes"] == {"converged": 10 - failures, "max_iterations": failures}
    # Machine and command line leave no trace.
    assert json.loads((folder / "dataset.json").read_text()) == manifest
    assert not {str(folder), "workers"} & set(json.dumps(manifest).split('"'))


def test_records_of_simulated_drapes_hold_their_derivatives():
    made = []

    def solver(*arguments, **settings):
        made.append(drape(*arguments, **settings))
        return made[-1]

    record = make_record(0, replace(small_config(starts=("lowered",)), edge=0.009), solver=solver)
    exact = sensitivities(made[0], parameters=MOVED_BY).positions
    found = (record["moves"] * record["move_units"][:, None]).transpose(1, 0, 2)
    for near, one in zip(found, exact, strict=True):
        assert np.abs(near - one).max() < 0.0080 * np.abs(one).max()


def test_batches_on_a_device_make_the_same_records(tmp_path, monkeypatch):
    monkeypatch.setattr(batches, "WINDOW", 1)
    config = replace(small_config(drapes=2, starts=("lowered",), testers=(DISC_RIG.name,)),
                     edge=0.014, drapes_per_shard=1)
    for name, device in (("one", None), ("batch", "cpu")):
        made = replace(config, device=device)
        assert generate(tmp_path / name, made, solver=None)["complete"]
        assert generate(tmp_path / name, made, solver=fake_drapes.killed)
    names = [path.name for path in shards(tmp_path / "one")]
    assert names == [path.name for path in shards(tmp_path / "batch")] and len(names) == 2
    for one, batch in ((Shard(tmp_path / kind / name) for kind in ("one", "batch"))
                       for name in names):
        for row in range(len(one.column("index"))):
            moved = one.mesh(row)[0] - batch.mesh(row)[0]
            assert np.abs(moved).max() < 2e-6
        for name in ("index", "status", "edge", "density", "seed", "start", "folds", "theta"):
            assert one.column(name).tolist() == batch.column(name).tolist()
        assert np.allclose(one.column("move_units"), batch.column("move_units"), rtol=1e-3)


def test_borrowed_drapes_are_not_made_in_batches(tmp_path):
    for device, starts, complaint in (("cpu", ("borrowed", "sine"), "drapes that are borrowed"),
                                      ("none", ("lowered",), "device=none: ")):
        with pytest.raises(InputError, match=complaint):
            generate(tmp_path / "set", replace(small_config(starts=starts), device=device))
    assert not (tmp_path / "set").exists()


def test_a_run_without_parts_completes_what_parts_have_left(finished, tmp_path):
    manifest = generate(tmp_path / "set", part=2, parts=3)
    assert manifest["complete"] is False and "hash" not in manifest
    assert not json.loads((tmp_path / "set" / "dataset.json").read_text())["complete"]
    generate(tmp_path / "set")
    assert files(tmp_path / "set") == files(finished[0])


@pytest.mark.parametrize("damage", ["missing", "cut", "empty", "bit", "seal", "foreign"])
def test_missing_and_damaged_shards_are_made_again(finished, tmp_path, damage):
    folder = tmp_path / "set"
    shutil.copytree(finished[0], folder)
    victim, whole = folder / "shard_00001.h5", (folder / "shard_00001.h5").read_bytes()
    untouched = (folder / "shard_00002.h5").stat().st_mtime_ns
    (folder / "shard_00002.h5.part").write_bytes(b"left over")
    (folder / "shard_00000.h5.0123abcd.part").write_bytes(b"left over")
    (folder / "dataset.json.0123abcd.part").write_bytes(b"left over")
    (folder / "film.mkv.part").write_bytes(b"somebody else's")
    if damage == "missing":
        victim.unlink()
    elif damage == "foreign":
        victim.write_bytes((folder / "shard_00002.h5").read_bytes())
    else:
        position = {"bit": 2 * len(whole) // 3, "seal": 300}.get(damage, 0)
        flipped = bytearray(whole)
        flipped[position] ^= 4
        victim.write_bytes({"cut": whole[:-1], "empty": b""}.get(damage, bytes(flipped)))
    generate(folder)
    assert (folder / "film.mkv.part").read_bytes() == b"somebody else's"
    (folder / "film.mkv.part").unlink()
    assert files(folder) == files(finished[0])
    assert (folder / "shard_00002.h5").stat().st_mtime_ns == untouched


def test_a_dataset_grows(finished, tmp_path):
    generate(tmp_path, small_config(drapes=6))
    first = (tmp_path / "shard_00000.h5").stat().st_mtime_ns
    generate(tmp_path)
    assert files(tmp_path) == files(finished[0])
    assert (tmp_path / "shard_00000.h5").stat().st_mtime_ns == first
    with pytest.raises(InputError, match=r"contains 10 drapes; drapes=\d must be 10 or more"):
        generate(tmp_path, small_config(drapes=6))


def test_a_run_ends_before_it_spoils_what_another_has_made_meanwhile(finished, tmp_path):
    config = small_config(drapes=6)
    slow, other = DatasetFolder(tmp_path, config), DatasetFolder(tmp_path, small_config(seed=1))
    slow.claim()
    slow.begin()
    generate(tmp_path)
    records = [make_record(index, config, solver=fake_drapes.cone) for index in config.rows(1)]
    for folder, complaint in ((slow, "contains 10 drapes"), (other, r"sampling\.seed")):
        with pytest.raises(InputError, match=complaint):
            folder.write(1, records)
    assert files(tmp_path) == files(finished[0])


def test_another_configuration_is_refused(tmp_path):
    generate(tmp_path, small_config(drapes=1))
    before = files(tmp_path)
    with pytest.raises(InputError, match=r"sampling\.drift, solver\.edge_mm\)"):
        generate(tmp_path, replace(small_config(drapes=1, drift=0.001), edge=0.025))
    assert files(tmp_path) == before


def test_a_folder_of_other_things_is_not_a_datasets(tmp_path):
    for name in ("notes.md", "shard_00000.h5"):
        (tmp_path / name).write_text("mine")
        with pytest.raises(InputError, match=rf"holds {name} and no dataset"):
            generate(tmp_path)
        assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {name: "mine"}
        (tmp_path / name).unlink()
    (tmp_path / ".hidden").touch()
    assert generate(tmp_path, small_config(drapes=2))["drapes"] == 2


def test_shards_without_a_manifest_are_taken_up_if_they_are_the_datasets(finished, tmp_path):
    folder = tmp_path / "set"
    shutil.copytree(finished[0], folder)
    (folder / "dataset.json").unlink()
    with pytest.raises(InputError, match=r"holds shard_00000\.h5 and no dataset"):
        generate(folder, small_config(seed=5))
    # Where they were made is not known any more.
    assert generate(folder, solver=fake_drapes.killed) == finished[1] | {"provenance": []}


def test_accidents_of_the_solver_are_recorded(tmp_path):
    record = make_record(0, small_config(), solver=fake_drapes.overflowing)
    assert record["status"] == b"exception"
    assert record["message"] == b"FloatingPointError: overflow in the bending energy"
    record = make_record(0, small_config(), solver=fake_drapes.exploding)
    assert record["status"] == b"out_of_range"
    assert not record["positions"].any()
    assert generate(tmp_path, small_config(drapes=2), solver=fake_drapes.overflowing)[
        "outcomes"] == {"exception": 2}


def no_folds(*_):
    raise FloatingPointError("no outline")


def test_accidents_of_measures_are_recorded(monkeypatch):
    assert make_record(1, small_config(), solver=fake_drapes.cone)["status"] == b"converged"
    monkeypatch.setattr("sim.measures.fold_count", no_folds)
    record = make_record(1, small_config(), solver=fake_drapes.cone)
    assert record["message"] == b"FloatingPointError: no outline"
    assert record["status"] == b"exception" and record["positions"].any()
    assert np.isnan(record["drape_coefficient"]) and record["folds"] == -1


@pytest.mark.skipif(PardisoSolver not in available_solvers(), reason="PARDISO is not here")
def test_only_running_out_of_memory_ends_more_than_a_drape(monkeypatch):
    def factor(fabric, **settings):
        PardisoSolver(SparsePattern([np.arange(3)[None]], 3)).factorise(np.ones(6))

    for code in (-1, -3, -7):
        monkeypatch.setattr(linear.PardisoFactor, "_call", lambda *_, code=code: code)
        message = make_record(0, small_config(), solver=factor)["message"]
        assert message == f"LinAlgError: PARDISO ended with error {code}".encode()
    monkeypatch.setattr(linear.PardisoFactor, "_call", lambda *_: -2)
    with pytest.raises(MemoryError):
        make_record(0, small_config(), solver=factor)


def test_a_killed_worker_is_reported_in_one_line(tmp_path):
    with pytest.raises(InputError, match="run the same command again"):
        generate(tmp_path, solver=fake_drapes.killed, workers=2)
