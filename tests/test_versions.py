"""What is stored and used again is of the version that its code states.

``versions.json`` describes each artefact by version. An artefact that differs from the description
of its version is either a fault, or meant: then raise the version, and run ``PYTHONPATH=.:tests
python tests/test_versions.py``, which adds what is missing. Types and shapes are compared, and
means and deviations rather than bytes: last digits differ between processors.
"""

import json
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import pytest
from checkpoints import description, save_untrained
from safetensors.numpy import load_file

import data.dataset.config
import drapenet.fabric.part
import drapenet.network.checkpoint
import drapenet.network.dataset
from common.cases import load_arrays, run_cases
from common.files import replace_json
from data.dataset.config import DatasetConfig, SamplingConfig
from data.dataset.shards import SCHEMA_VERSION, Shard, fields, write_shard
from data.dataset.simulate import make_record
from data.fabrics.prior import load_prior
from data.render.setups import Setups
from drapenet.config import EstimateOptions
from drapenet.fabric.part import make_in_folder
from drapenet.fabric.sources import Source
from drapenet.network.dataset import maps_of_shard

STORED = Path(__file__).with_name("versions.json")
ROOT = Path(__file__).parents[1]
UNSTEADY = ("residual", "iterations", "check")
"""Columns that rounding changes."""

Described = dict[str, str | float]
"""Type and shape of arrays by name, their mean sizes and deviations, and what else is stored."""


def described(arrays: Mapping[str, np.ndarray]) -> Described:
    """The description of arrays, of any shape."""
    found: Described = {}
    for name, array in arrays.items():
        found[name] = f"{array.dtype} {array.shape}"
        if array.dtype.kind in "US":
            found[f"{name}: values"] = " ".join(sorted(set(map(str, array.ravel().tolist()))))
        elif name not in UNSTEADY and np.isfinite(array).any():
            values = array[np.isfinite(array)].astype(float)
            found[f"{name}: size"] = float(f"{np.abs(values).mean():.6g}")
            found[f"{name}: deviation"] = float(f"{values.std():.6g}")
    return found


def shard(folder: Path) -> Shard:
    """A drape of one fabric on a coarse mesh."""
    config = DatasetConfig(1, SamplingConfig(seed=1), load_prior("gaussian"), edge=0.02)
    file = folder / "shard_00000.h5"
    write_shard(file, [make_record(0, config)], attributes={"schema_version": SCHEMA_VERSION})
    return Shard(file)


def drapes(folder: Path) -> Described:
    made = shard(folder)
    return described({name: made.column(name) for name in fields(0, 0)})


def maps(folder: Path) -> Described:
    return described(vars(maps_of_shard(shard(folder), setups=Setups.load(), captures=2, seed=1,
                                        neighbours=True, outlines=1)))


def squares(number: int) -> dict:
    """Work of a case."""
    return {"sum": number**2, "arrays": {"numbers": np.arange(number)}}


def case(folder: Path) -> Described:
    run_cases(squares, {"three": {"number": 3}}, folder=folder)
    return {"three.json": (folder / "three.json").read_text("utf-8"),
            **described(load_arrays(folder, "three"))}


def part(folder: Path) -> Described:
    """Files of a source of a fabric, by weights that no training changes."""
    source = Source(place=ROOT / "examples/captures/twill_photograph")
    checkpoint = save_untrained(folder / "untrained.safetensors")
    folder /= "part"
    folder.mkdir()
    make_in_folder(source, folder, "", EstimateOptions(drapes=0), checkpoint)
    return {"files": " ".join(sorted(file.name for file in folder.iterdir())),
            **described(load_arrays(folder, "samples")),
            **described(load_arrays(folder, "observation"))}


def checkpoint(folder: Path) -> Described:
    """Keys and tensors; initial weights are PyTorch's."""
    file = save_untrained(folder / "untrained.safetensors")
    return {"keys": " ".join(sorted(description(file))),
            **{name: f"{one.dtype} {one.shape}" for name, one in load_file(file).items()}}


ARTEFACTS: dict[str, tuple[int, Callable[[Path], Described]]] = {
    "drapes": (data.dataset.config.VERSION, drapes),
    "maps": (drapenet.network.dataset.VERSION, maps),
    "case": (1, case),
    "part": (drapenet.fabric.part.VERSION, part),
    "checkpoint": (drapenet.network.checkpoint.SCHEMA_VERSION, checkpoint),
}


@pytest.mark.parametrize("name", ARTEFACTS)
def test_an_artefact_is_of_its_version(tmp_path, name):
    version, make = ARTEFACTS[name]
    stored = json.loads(STORED.read_text("utf-8"))[name]
    assert str(version) in stored, f"describe version {version} of {name}, see above"
    found, expected = make(tmp_path), stored[str(version)]
    assert found.keys() == expected.keys()
    for key, value in expected.items():
        same = pytest.approx(value, rel=5e-4, abs=1e-9) if isinstance(value, float) else value
        assert found[key] == same, f"{key} of {name} changed: raise the version, see above"


def describe_new_versions() -> None:
    """Add what is missing in ``versions.json``."""
    content = json.loads(STORED.read_text("utf-8")) if STORED.exists() else {}
    for name, (version, make) in ARTEFACTS.items():
        if str(version) not in content.setdefault(name, {}):
            with tempfile.TemporaryDirectory() as folder:
                content[name][str(version)] = make(Path(folder))
    replace_json(STORED, content)


if __name__ == "__main__":
    describe_new_versions()
