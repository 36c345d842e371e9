"""Captures that a test may spoil."""

from pathlib import Path

import numpy as np
import pytest
from cloths import lopsided_views
from spoiled import STARTS

from sim.draping import Drape, drape
from sim.material import Fabric
from sim.rig import DISC_RIG


@pytest.fixture(scope="session")
def views() -> np.ndarray:
    """Of a plate with a lopsided skirt, by the nominal camera."""
    return lopsided_views()


@pytest.fixture(scope="session")
def shape() -> Drape:
    """A disc of a limp fabric."""
    fabric = Fabric(alpha=[30e-6, 22e-6, 18e-6], beta=[-30e-9] * 3, density=0.15)
    return drape(fabric, rig=DISC_RIG, edge=9e-3)


def sound(name: str, folder: Path) -> Path:
    folder.mkdir()
    STARTS[name].write(folder)
    return folder


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A good capture in the 16-bit format."""
    return sound("views", tmp_path / "capture")


@pytest.fixture
def published(tmp_path: Path) -> Path:
    """A good capture in the 8-bit format."""
    return sound("published", tmp_path / "published")
