"""Fixtures that several folders of tests share."""

import os
import signal
import sys
from pathlib import Path
from types import SimpleNamespace

import shapes  # before what it checks

# isort: split
import cloths
import pytest
import torch
from checkpoints import save_untrained
from here import here

import common.cases
import common.interrupt
import data.dataset.generate
from drapenet.fabric.stages import RAISE
from sim.rig import DISC_RIG
from sim.scene import Scene, make_specimen

signal.signal(signal.SIGINT, signal.default_int_handler)  # pytest's
os.environ[RAISE] = "1"  # an error of a stage is no warning
# Without bytecode each worker compiles all tests, in 15 s, and each process that a test starts all
# sources.
sys.dont_write_bytecode = False
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
torch.set_num_threads(1)  # of each worker; sums of several may differ by rounding from run to run

for module in (common.cases, data.dataset.generate):
    module.worker_pool = here


@pytest.fixture
def any_shapes(monkeypatch) -> None:
    """Arrays of wrong shapes reach functions, which are to refuse them."""
    monkeypatch.setattr(shapes, "enabled", False)


@pytest.fixture(scope="session")
def cloth_dataset(tmp_path_factory) -> Path:
    """Folder of a dataset of 24 pieces of cloth."""
    return cloths.write_dataset(tmp_path_factory.mktemp("cloths") / "dataset", drapes=24, seed=8)


@pytest.fixture(scope="session")
def skirted() -> SimpleNamespace:
    """A square of cloth that hangs in folds."""
    return cloths.skirt()


@pytest.fixture(scope="session")
def disc() -> Scene:
    """A disc on a coarse mesh of equal edges."""
    return make_specimen(DISC_RIG, edge=9e-3, grading=1.0)


@pytest.fixture(scope="session")
def untrained_checkpoint(tmp_path_factory) -> Path:
    """A checkpoint with plausible description and random weights, for what does not need skill."""
    return save_untrained(tmp_path_factory.mktemp("checkpoint") / "untrained.safetensors")
