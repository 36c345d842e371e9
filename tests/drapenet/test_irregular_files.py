"""Pipes, devices and sparse files in place of every file that a user may give."""

import os
from collections.abc import Callable
from pathlib import Path

import pytest

from apps.drape_file import read_borrowed
from apps.strip_curves import read_curve
from common.errors import InputError
from data.captures.description import OutlineSource
from data.captures.frames import read_array, read_exr, read_picture, read_points
from data.captures.outline_table import read_closed_curve
from data.captures.raw_scans import read_raw_scan
from data.captures.reader import read_capture
from data.captures.rosbag import read_recording
from data.captures.scans import read_scan
from data.dataset.folder import read_manifest
from data.dataset.shards import Shard
from data.fabrics.fabrics import read_fabric_table
from data.fabrics.prior import load_prior
from data.pictures.reading import read_photograph
from drapenet.export.material import read_material
from drapenet.fabric.entries import entries_of
from drapenet.network.checkpoint import read_header
from drapenet.network.model import make_network
from drapenet.network.optimizer import Optimizer
from drapenet.network.training import load_state
from sim.rig import DISC_RIG


def _state(file: Path) -> None:
    model = make_network(width=2, components=1, dropout=0.0, distance=0.5, spread=0.1)
    load_state(file, run={}, model=model, optimizer=Optimizer(model, weight_decay=0.1))


READERS: dict[str, Callable[[Path], object]] = {
    "capture.yaml": lambda file: read_capture(file.parent),
    "density.txt": lambda file: read_capture(file.parent),
    "outline.csv": lambda file: read_closed_curve(file, OutlineSource(unit="mm")),
    "outline.jpg": read_photograph,
    "view_0.png": lambda file: read_picture(file, modes={"I;16"}, kind="16-bit grey"),
    "view_0.npy": read_array,
    "view_0.exr": read_exr,
    "view_0.ply": lambda file: read_points(file, None),
    "depth.bag": lambda file: read_recording([file]),
    "scan.npz": lambda file: read_scan(file, DISC_RIG),
    "scan.obj": lambda file: read_raw_scan(file, DISC_RIG),
    "drape.npz": read_borrowed,
    "fabrics.csv": read_fabric_table,
    "curve.csv": read_curve,
    "list.csv": entries_of,
    "prior.json": load_prior,
    "dataset.json": lambda file: read_manifest(file.parent),
    "shard_00000.h5": Shard,
    "net.safetensors": read_header,
    "state.pt": _state,
    "estimate.json": read_material,
}


@pytest.mark.parametrize("name", READERS)
def test_only_regular_files_of_bounded_size_are_read(tmp_path, name):
    def sparse(file: Path) -> None:
        with file.open("wb") as stream:
            stream.truncate(1 << 43)

    for make, complaint in ((os.mkfifo, "not a regular file"),
                            (lambda file: file.symlink_to("/dev/zero"), "not a regular file"),
                            (sparse, "has 8796093022208 bytes; ")):
        make(tmp_path / name)
        with pytest.raises(InputError, match=complaint):
            READERS[name](tmp_path / name)
        (tmp_path / name).unlink()
