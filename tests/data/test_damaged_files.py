"""The smallest of the damaged files that readers once failed at otherwise than by one line."""

import hashlib
import zlib
from pathlib import Path

import fake_drapes
import h5py
import numpy as np
import pytest
from PIL import Image

from common.errors import InputError
from data.captures.frames import read_array, read_picture
from data.dataset.folder import DatasetFolder
from data.dataset.inspect.check import check_dataset
from data.dataset.manifest import json_digest, read_manifest
from data.dataset.manifest import write_manifest as write
from data.dataset.plan import SamplingConfig
from data.dataset.shards import SEAL_SIZE, Shard, _seal
from data.dataset.simulate import DatasetConfig, make_record
from data.fabrics.prior import load_prior


def test_a_picture_without_pixels_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "view_0.png"
    Image.fromarray(np.full((60, 80), 500, np.uint16)).save(file)
    data = file.read_bytes()
    at = data.index(b"IDAT") - 4
    length = int.from_bytes(data[at : at + 4], "big")
    file.write_bytes(data[:at] + data[at + length + 12 :])
    with pytest.raises(InputError, match="export the view again"):
        read_picture(file, modes={"I;16"}, kind="16-bit grey")


def test_an_exploding_picture_takes_no_more_than_its_pixels(tmp_path: Path) -> None:
    file = tmp_path / "view_0.png"
    Image.fromarray(np.full((60, 80), 500, np.uint16)).save(file)
    data = file.read_bytes()
    at = data.index(b"IDAT") - 4
    bomb = b"IDAT" + zlib.compress(bytes(1 << 24), 9)
    file.write_bytes(data[:at] + (len(bomb) - 4).to_bytes(4, "big") + bomb
                     + zlib.crc32(bomb).to_bytes(4, "big") + data[-12:])
    assert not read_picture(file, modes={"I;16"}, kind="16-bit grey").any()


@pytest.mark.parametrize("header", [b"{'descr': '<f8', 'fortran_order': False, 'shape': (60, 80",
                                    b"{'descr': '|O', 'fortran_order': False, 'shape': (60, 80), }",
                                    b"((((((((", b"\xff"])
def test_a_torn_header_of_an_array_is_refused(tmp_path: Path, header: bytes) -> None:
    file = tmp_path / "view_0.npy"
    file.write_bytes(b"\x93NUMPY\x01\x00" + (len(header) + 1).to_bytes(2, "little") + header
                     + b"\n" + bytes(60 * 80 * 8))
    with pytest.raises(InputError, match=r"view_0\.npy"):
        read_array(file)


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dataset of one shard."""
    config = DatasetConfig(drapes=4, sampling=SamplingConfig(), prior=load_prior("gaussian"),
                           edge=0.04)
    folder = DatasetFolder(tmp_path_factory.mktemp("shard") / "set", config)
    folder.claim()
    folder.write(0, [make_record(index, config, solver=fake_drapes.cone) for index in range(4)])
    folder.finish()
    return folder.root


def hide(root: Path, content: bytes) -> None:
    """Write a damaged shard with digests that do not reveal it."""
    path = root / "shard_00000.h5"
    path.write_bytes(_seal(hashlib.sha256(content).hexdigest()) + content)
    digests = {path.name: hashlib.sha256(path.read_bytes()).hexdigest()}
    write(root, read_manifest(root) | {"shards": digests, "hash": json_digest(digests)})


@pytest.fixture
def copy(dataset: Path, tmp_path: Path) -> Path:
    for file in dataset.iterdir():
        (tmp_path / file.name).write_bytes(file.read_bytes())
    return tmp_path


def test_a_shard_of_broken_structure_is_refused(copy: Path) -> None:
    content = (copy / "shard_00000.h5").read_bytes()[SEAL_SIZE:]
    for signature in (b"SNOD", b"TREE", b"HEAP"):
        hide(copy, content.replace(signature, b"XXXX"))
        with pytest.raises(InputError, match=r"damaged|not a readable|type or shape"):
            Shard(copy / "shard_00000.h5")


@pytest.mark.parametrize(("name", "value"), [
    ("folds", 2**31 - 1), ("theta", np.nan), ("mesh", 9), ("vertices", 2**20), ("rejected", -1),
    ("drape_coefficient", np.inf)])
def test_values_that_no_drape_has_are_refused(copy: Path, name: str, value: float) -> None:
    with h5py.File(copy / "shard_00000.h5", "r+") as file:
        file["status"][0] = b"converged"
        file[name][0] = value
    hide(copy, (copy / "shard_00000.h5").read_bytes()[SEAL_SIZE:])
    with pytest.raises(InputError, match=f"{name} has values that no drape has"):
        check_dataset(copy)


def test_arrays_that_are_missing_or_stand_elsewhere_are_refused(copy: Path) -> None:
    (copy / "secret").write_bytes(bytes(32))
    for array in (None, {"shape": (4,), "dtype": "f8"}, {"shape": (2**40,), "dtype": "i8"},
                  {"shape": (4,), "dtype": "i8", "external": [(str(copy / "secret"), 0, 32)]}):
        with h5py.File(copy / "shard_00000.h5", "r+") as file:
            if "fabric" in file:
                del file["fabric"]
            if array:
                file.create_dataset("fabric", **array)
        hide(copy, (copy / "shard_00000.h5").read_bytes()[SEAL_SIZE:])
        with pytest.raises(InputError, match=r"fabric does not have the type or shape"):
            check_dataset(copy)
