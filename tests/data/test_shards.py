import hashlib
import time

import h5py
import numpy as np
import pytest

from common.errors import InputError
from data.dataset.levels import Levels
from data.dataset.shards import (
    SCHEMA_VERSION,
    SEAL_SIZE,
    Shard,
    fields,
    to_counts,
    to_moves,
    write_shard,
)
from data.fabrics.nuisances import Nuisances
from sim.mesh.specimen import TOPOLOGIES, mesh_specimen
from sim.rig import DISC_RIG, SQUARE_RIG, Rig
from tests.cloths import waves

RIGS = DISC_RIG, SQUARE_RIG, Rig((0.17, 0.25), 0.09, rim=2e-3)
CODED = ("check", "positions", "moves")
ATTRIBUTES = {"schema_version": SCHEMA_VERSION, "identity": "abc", "config": "{}"}


def flat(seed):
    """Mesh of the specimen of a record."""
    nuisances = Nuisances(size=1e-4 * seed, plate=-2e-4, cut=0.01 * seed)
    rig = RIGS[seed % 3]
    mesh, _ = mesh_specimen(nuisances.rig(rig), edge=0.011 + 0.001 * seed, offset=(2e-3, 1e-3),
                            topology=(5 + seed) % TOPOLOGIES)
    return mesh, {"nuisances": nuisances.vector, "specimen": rig.specimen.encode(),
                  "sides": rig.sides, "plate_diameter": rig.plate_diameter, "rim": rig.rim,
                  "seed": 5 + seed,
                  "edge": 0.011 + 0.001 * seed, "offset": np.array([2e-3, 1e-3])}


def make_record(seed):
    """A drape in waves, with derivatives, all else at random."""
    rng, record = np.random.default_rng(seed), {}
    for name, field in fields(1, 1).items():
        if field.dtype.startswith("S"):
            record[name] = f"{name}{seed}".encode()[: int(field.dtype[1:])]
        elif field.dtype.startswith("f"):
            record[name] = rng.normal(size=field.shape)
        else:
            record[name] = rng.integers(0, 100, field.shape)
    mesh, planned = flat(seed)
    shape = waves(mesh.rest, phase=seed)
    moves = to_moves(np.array([waves(mesh.rest, phase=seed + k, depth=k) for k in range(7)]))
    return record | planned | moves | {
        "vertices": len(shape), "positions": to_counts(shape), "rest": to_counts(mesh.rest)}


@pytest.fixture
def shard(tmp_path):
    write_shard(tmp_path / "s.h5", [make_record(0), make_record(1)], attributes=ATTRIBUTES)
    return Shard(tmp_path / "s.h5")


def test_every_field_comes_back(shard):
    assert len(shard) == 2
    for name in fields(1, 1).keys() - CODED:
        for found, expected in zip(shard.column(name), map(make_record, (0, 1)), strict=True):
            value = expected[name]
            assert np.array_equal(found, value.decode() if isinstance(value, bytes) else value)


def test_derivatives_come_back_at_a_part_of_the_vertices(tmp_path):
    """To half a 63rd of the largest where they are stored, and nearly as well where the nearest
    ones predict them."""
    rest = flat(1)[0].rest
    scale = np.array([1e-2, 1e-3, 1e-2, 1.0, 2.0, 3.0, 1e-4])
    moves = scale[:, None, None] * np.array([waves(rest, phase=k) for k in range(7)])
    records = [make_record(1) | to_moves(moves), make_record(1) | to_moves(0 * moves)]
    write_shard(tmp_path / "s.h5", records, attributes=ATTRIBUTES)
    shard = Shard(tmp_path / "s.h5")
    found = shard.moves(0)
    assert found.shape == moves.shape and shard.moves(1) is None
    error, largest = np.abs(found - moves).max(axis=2), np.abs(moves).max(axis=(1, 2))
    exact = (error <= 0.0080 * largest[:, None]).all(axis=0)
    assert exact.mean() > 0.35 and (error.mean(axis=1) < 0.03 * largest).all()


def test_attributes_and_units(shard):
    assert shard.attributes["identity"] == "abc"
    assert shard.attributes["schema_version"] == SCHEMA_VERSION
    with h5py.File(shard.path) as file:
        assert file["offset"].attrs["unit"] == b"m"
        assert file["positions"].attrs["unit"] == b"1e-5 m"


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_mesh_and_tester_come_back(tmp_path, seed):
    mesh, record = flat(seed)[0], make_record(seed)
    shape = waves(mesh.rest, phase=seed)
    write_shard(tmp_path / "s.h5", [record], attributes=ATTRIBUTES)
    shard = Shard(tmp_path / "s.h5")
    positions, rest, faces = shard.mesh(0)
    assert np.abs(positions - shape).max() <= 0.5001e-5
    assert np.abs(rest - mesh.rest).max() <= 0.5001e-5
    np.testing.assert_array_equal(faces, mesh.faces)
    assert shard.rig(0) == RIGS[seed]


def test_a_drape_without_mesh_has_none(tmp_path):
    lost = {"vertices": 0, "positions": np.zeros((0, 3)), "rest": np.zeros((0, 2)),
            "moves": np.zeros((0, 7, 3)), "move_units": np.zeros(7)}
    records = [make_record(0), make_record(1) | lost]
    write_shard(tmp_path / "s.h5", records, attributes=ATTRIBUTES)
    shard = Shard(tmp_path / "s.h5")
    assert [len(part) for part in shard.mesh(1)] == [0, 0, 0] and shard.moves(1) is None
    assert len(shard.mesh(0)[0]) == records[0]["vertices"]


@pytest.mark.parametrize("change", [{"seed": 6}, {"edge": 0.012}, {"plate_diameter": 0.1801},
                                    {"rest": to_counts(flat(0)[0].rest + 2e-5)}])
def test_a_mesh_that_is_made_otherwise_today_is_refused(tmp_path, change):
    write_shard(tmp_path / "s.h5", [make_record(0) | change], attributes=ATTRIBUTES)
    with pytest.raises(InputError, match=r"drape \d+ is on a mesh that this version does not make"):
        Shard(tmp_path / "s.h5").mesh(0)


@pytest.mark.parametrize("count", [0, 3, 24, 40, 700])
def test_coded_values_come_back_whatever_they_are(count):
    rng = np.random.default_rng(count)
    levels = Levels(rng.integers(-15000, 15000, (count, 2)))
    limits = np.iinfo(np.int16)
    values = rng.integers(limits.min, limits.max, (count, 3)).astype(np.int16)
    np.testing.assert_array_equal(levels.decoded(levels.coded(values)), values)


@pytest.mark.parametrize("value", [0.328, -0.328, np.nan, np.inf])
def test_counts_refuse_what_they_cannot_hold(value):
    with pytest.raises(OverflowError, match="outside"):
        to_counts(np.array([0.0, value]))


def test_bytes_depend_on_the_content_alone(tmp_path):
    paths = [tmp_path / "a.h5", tmp_path / "b.h5"]
    write_shard(paths[0], [make_record(0)], attributes=ATTRIBUTES)
    time.sleep(1.1)  # HDF5 can store times, in whole seconds
    write_shard(paths[1], [make_record(0)], attributes=ATTRIBUTES)
    assert paths[0].read_bytes() == paths[1].read_bytes()


def test_every_flipped_bit_and_every_missing_byte_shows(shard, tmp_path):
    whole = shard.path.read_bytes()
    assert shard.digest == hashlib.sha256(whole).hexdigest()
    damaged = tmp_path / "damaged.h5"
    rng = np.random.default_rng(0)
    positions = [0, 511, 512, len(whole) - 1, *rng.integers(len(whole), size=40)]
    for position in positions:
        content = bytearray(whole)
        content[position] ^= 1 << int(rng.integers(8))
        damaged.write_bytes(content)
        with pytest.raises(InputError, match="damaged"):
            Shard(damaged)
    for content in (b"", whole[:100], whole[:SEAL_SIZE], whole[:-1], whole + b"\0"):
        damaged.write_bytes(content)
        with pytest.raises(InputError, match="damaged"):
            Shard(damaged)


def test_the_seal_is_that_of_the_documentation(shard):
    whole = shard.path.read_bytes()
    first, second, rest = whole[:SEAL_SIZE].split(b"\n")
    assert first == b"drapes, schema 10, SHA-256 of all after byte 512:"
    assert second.decode() == hashlib.sha256(whole[512:]).hexdigest()
    assert not rest.strip(b"\0")


def test_other_files_are_no_shard(tmp_path):
    (tmp_path / "text.h5").write_text("no shard")
    write_shard(tmp_path / "new.h5", [make_record(0)], attributes=ATTRIBUTES)
    content = (tmp_path / "new.h5").read_bytes()
    (tmp_path / "old.h5").write_bytes(content.replace(b"schema 10", b"schema 09", 1))
    for name, complaint in (("text.h5", "not a shard"), ("none.h5", "No such file"),
                            ("old.h5", "not a shard of schema version 10")):
        with pytest.raises(InputError, match=complaint):
            Shard(tmp_path / name)
