import hashlib
import re
import time
from pathlib import Path

import h5py
import numpy as np
import pytest

from common.errors import InputError
from data.dataset.shards import (
    SCHEMA_VERSION,
    SEAL_SIZE,
    Shard,
    fields,
    to_counts,
    to_moves,
    write_shard,
)
from sim.rig import Rig

VERTICES = 81
ATTRIBUTES = {"schema_version": SCHEMA_VERSION, "identity": "abc", "config": "{}"}


def random_record(seed):
    rng = np.random.default_rng(seed)
    record = {}
    triangles = 60 + 10 * seed
    for name, field in fields(VERTICES, triangles).items():
        if field.dtype.startswith("S"):
            record[name] = f"{name}{seed}".encode()[: int(field.dtype[1:])]
        elif field.dtype.startswith("f"):
            record[name] = rng.normal(size=field.shape)
        else:
            record[name] = rng.integers(0, 100, field.shape)
    faces = rng.integers(1, VERTICES, (triangles, 3))
    return record | {"vertices": VERTICES, "mesh": seed, "faces": faces}


@pytest.fixture
def shard(tmp_path):
    write_shard(tmp_path / "s.h5", [random_record(0), random_record(1)], attributes=ATTRIBUTES)
    return Shard(tmp_path / "s.h5")


def test_every_field_comes_back(shard):
    assert len(shard) == 2
    for name in fields(VERTICES, 3):
        rows = shard.column(name)
        for row, seed in enumerate((0, 1)):
            expected = random_record(seed)[name]
            if isinstance(expected, bytes):
                assert rows[row] == expected.decode()
            elif name == "origin":  # padded
                np.testing.assert_array_equal(rows[row][: len(expected)], expected)
            else:
                np.testing.assert_array_equal(rows[row], expected)


def test_derivatives_come_back_to_a_two_hundredth_of_the_largest(tmp_path):
    scale = np.array([1e-2, 1e-3, 1e-2, 1.0, 2.0, 3.0, 1e-4])
    moves = scale[:, None, None] * np.random.default_rng(0).normal(size=(7, VERTICES, 3))
    records = [random_record(0) | to_moves(moves), random_record(1) | to_moves(0 * moves)]
    write_shard(tmp_path / "s.h5", records, attributes=ATTRIBUTES)
    shard = Shard(tmp_path / "s.h5")
    found = shard.moves(0)
    assert found.shape == moves.shape and shard.moves(1) is None
    error, largest = (np.abs(x).max(axis=(1, 2)) for x in (found - moves, moves))
    assert (error <= 0.0040 * largest).all()


def test_attributes_and_units(shard):
    assert shard.attributes["identity"] == "abc"
    assert shard.attributes["schema_version"] == SCHEMA_VERSION
    with h5py.File(shard.path) as file:
        assert file["offset"].attrs["unit"] == b"m"
        assert file["positions"].attrs["unit"] == b"1e-5 m"


def test_mesh_comes_back_to_a_hundredth_of_a_millimetre(tmp_path):
    rng = np.random.default_rng(0)
    positions = rng.uniform(-0.2, 0.2, (81, 3))
    rest = rng.uniform(-0.15, 0.15, (81, 2))
    record = random_record(0) | {
        "positions": to_counts(positions),
        "rest": to_counts(rest),
    }
    write_shard(tmp_path / "s.h5", [record], attributes=ATTRIBUTES)
    back = Shard(tmp_path / "s.h5").mesh(0)
    assert np.abs(back[0] - positions).max() <= 0.5001e-5
    assert np.abs(back[1] - rest).max() <= 0.5001e-5
    np.testing.assert_array_equal(back[2], record["faces"])


def test_tester_and_origins_of_a_drape_come_back(tmp_path):
    records = [random_record(0), random_record(1), random_record(2)]
    rectangle = Rig((0.17, 0.25), 0.09)
    for record, rig in zip(records, (Rig(0.254, 0.127, "disc"), Rig(), rectangle), strict=True):
        record |= {"specimen": rig.specimen.encode(), "sides": rig.sides,
                   "plate_diameter": rig.plate_diameter, "face": -1}
    write_shard(tmp_path / "s.h5", records, attributes=ATTRIBUTES)
    shard = Shard(tmp_path / "s.h5")
    assert shard.rig(0).name == "disc254_support127" and shard.rig(1) == Rig()
    assert shard.rig(2) == rectangle
    assert shard.column("face").tolist() == [-1, -1, -1]
    for row, record in enumerate(records):  # of as many triangles as the drape has
        np.testing.assert_allclose(shard.origin(row), 0.1 * record["origin"])


def test_each_triangulation_is_stored_once(tmp_path):
    records = [random_record(seed) for seed in (0, 1, 0)]
    small = {"vertices": 7, "positions": records[0]["positions"][:7],
             "rest": records[0]["rest"][:7], "faces": np.array([[0, 1, 2]]),
             "origin": records[0]["origin"][:1]}
    lost = {"vertices": 0, "positions": np.zeros((0, 3)), "rest": np.zeros((0, 2)),
            "faces": np.zeros((0, 3)), "origin": np.zeros((0, 3))}
    records += [records[0] | small, records[0] | lost]
    write_shard(tmp_path / "s.h5", records, attributes=ATTRIBUTES)
    shard = Shard(tmp_path / "s.h5")
    assert shard.column("mesh").tolist() == [0, 1, 0, 2, 3]
    for row, record in enumerate(records):
        positions, rest, faces = shard.mesh(row)
        assert len(positions) == len(rest) == record["vertices"]
        np.testing.assert_array_equal(faces, record["faces"])


@pytest.mark.parametrize("value", [0.328, -0.328, np.nan, np.inf])
def test_counts_refuse_what_they_cannot_hold(value):
    with pytest.raises(OverflowError, match="outside"):
        to_counts(np.array([0.0, value]))


def test_bytes_depend_on_the_content_alone(tmp_path):
    paths = [tmp_path / "a.h5", tmp_path / "b.h5"]
    write_shard(paths[0], [random_record(0)], attributes=ATTRIBUTES)
    time.sleep(1.1)  # HDF5 can store times, in whole seconds
    write_shard(paths[1], [random_record(0)], attributes=ATTRIBUTES)
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
    assert first == b"drapes, schema 8, SHA-256 of all after byte 512:"
    assert second.decode() == hashlib.sha256(whole[512:]).hexdigest()
    assert not rest.strip(b"\0")


def test_other_files_are_no_shard(tmp_path):
    (tmp_path / "text.h5").write_text("no shard")
    write_shard(tmp_path / "new.h5", [random_record(0)], attributes=ATTRIBUTES)
    content = (tmp_path / "new.h5").read_bytes()
    (tmp_path / "old.h5").write_bytes(content.replace(b"schema 8", b"schema 7", 1))
    for name, complaint in (("text.h5", "not a shard"), ("none.h5", "No such file"),
                            ("old.h5", "not a shard of schema version 8")):
        with pytest.raises(InputError, match=complaint):
            Shard(tmp_path / name)


def test_the_documentation_lists_every_field():
    text = (Path(__file__).parents[2] / "docs" / "data_format.md").read_text(encoding="utf-8")
    documented = re.findall(r"^\| `(\w+)` \| (?:int|float|text)", text, flags=re.MULTILINE)
    assert documented == list(fields(VERTICES, 3))
