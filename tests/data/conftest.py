"""Captures that a test may spoil."""

from pathlib import Path

import numpy as np
import pytest
from cloths import lopsided_views
from spoiled import STARTS


@pytest.fixture(scope="session")
def views() -> np.ndarray:
    """Of a plate with a lopsided skirt, by the nominal camera."""
    return lopsided_views()


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
