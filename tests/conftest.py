"""Fixtures that several folders of tests share."""

from collections.abc import Iterator
from pathlib import Path

import cloths
import pytest
from blobs import write_dataset


@pytest.fixture(scope="session")
def blob_dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a dataset of 64 blobs."""
    return write_dataset(tmp_path_factory.mktemp("blobs") / "dataset")


@pytest.fixture(scope="session")
def cloth_dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a dataset of 40 pieces of cloth without views."""
    return cloths.write_dataset(tmp_path_factory.mktemp("cloths") / "dataset", drapes=40, seed=8)


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

    from drapenet.checkpoint import save_checkpoint
    from drapenet.convention import TARGET_NAMES, TARGET_UNITS
    from drapenet.model import DrapeNet
    from drapenet.preprocess import InputFormat

    torch.manual_seed(0)
    mean = [-10.0, -10.6, -10.8, -0.0027, -0.0026, -0.0026]
    std = [0.9, 0.8, 0.8, 0.002, 0.002, 0.002]
    description = {
        "rig": "square300_cylinder100", "convention": "stiff/soft",
        "model": {"backbone": "resnet18"},
        "input": InputFormat(width=64, height=48).as_dict(),
        "targets": {"names": list(TARGET_NAMES), "units": list(TARGET_UNITS), "mean": mean,
                    "std": std, "low": [m - 2 * s for m, s in zip(mean, std, strict=True)],
                    "high": [m + 2 * s for m, s in zip(mean, std, strict=True)]},
        "dataset": {"sha256": "0" * 64,
                    "generation": {"sampling": {"seed": 999}, "prior": "blobs"}},
        "validation": {"rmse": dict.fromkeys(TARGET_NAMES, 0.5)},
        "config": {},
    }
    path = tmp_path_factory.mktemp("checkpoint") / "untrained.safetensors"
    save_checkpoint(path, model=DrapeNet(), description=description, half=False)
    return path
