"""Fixtures that several folders of tests share."""

import signal
from collections.abc import Iterator
from pathlib import Path

import cloths
import pytest

import common.interrupt  # noqa: F401
from sim.rig import DISC_RIG
from sim.scene import Scene, make_specimen

signal.signal(signal.SIGINT, signal.default_int_handler)  # pytest's


@pytest.fixture(scope="session")
def cloth_dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a dataset of 24 pieces of cloth."""
    return cloths.write_dataset(tmp_path_factory.mktemp("cloths") / "dataset", drapes=24, seed=8)


@pytest.fixture(scope="session")
def disc() -> Scene:
    """A disc on a coarse mesh of equal edges."""
    return make_specimen(DISC_RIG, edge=9e-3, grading=1.0)


@pytest.fixture(scope="module")
def one_thread() -> Iterator[None]:
    """Sums of several threads of torch may differ by rounding from run to run."""
    import torch

    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


@pytest.fixture(scope="session")
def untrained_checkpoint(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A checkpoint with plausible description and random weights, for what does not need skill."""
    import torch

    from common.configs import read_option
    from drapenet.network.checkpoint import save_checkpoint
    from drapenet.network.model import MapNet

    torch.manual_seed(0)
    mean, std = [-10.8, -11.0, -10.8, -0.0026, -0.0026, -0.0026], [0.9, 0.8, 0.9, *[0.0014] * 3]
    model = {"width": 8, "components": 2, "targets": 6, "distance": 0.076, "spread": 0.017}
    description = {
        "rig": "square300_cylinder100",
        "model": model,
        "targets": {"mean": mean, "std": std},
        "fabrics": {"low": [m - 2 * s for m, s in zip(mean, std, strict=True)],
                    "high": [m + 2 * s for m, s in zip(mean, std, strict=True)],
                    "deviation": std},
        "dataset": {"sha256": "0" * 64,
                    "generation": {"sampling": {"seed": 999, "starts": ["sine", "fold"]},
                                   "prior": "blobs",
                                   "solver": {"edge_mm": 8.0}}},
        "validation": {},
        "config": {"setup": dict(read_option("setup", "real"))},
    }
    path = tmp_path_factory.mktemp("checkpoint") / "untrained.safetensors"
    save_checkpoint(path, model=MapNet(**model), description=description, half=False)
    return path
