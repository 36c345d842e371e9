"""Captures that a test may spoil."""

from pathlib import Path

import numpy as np
import pytest
from cloths import lopsided_views
from PIL import Image

from data.captures.writer import write_capture
from data.render.cameras import nominal_camera
from sim.rig import SQUARE_RIG


@pytest.fixture(scope="session")
def views() -> np.ndarray:
    """Of a plate with a lopsided skirt, by the nominal camera."""
    return lopsided_views()


@pytest.fixture
def folder(tmp_path: Path, views: np.ndarray) -> Path:
    """A good capture in the 16-bit format."""
    path = tmp_path / "capture"
    write_capture(path, views=views, intrinsics=nominal_camera().intrinsics, density=0.15,
                  rig=SQUARE_RIG, warp_direction=0.3)
    return path


@pytest.fixture
def published(tmp_path: Path, views: np.ndarray) -> Path:
    """A good capture in the 8-bit format."""
    path = tmp_path / "published"
    path.mkdir()
    for k, view in enumerate(views):
        Image.fromarray(np.rint(view * 255).astype(np.uint8)).save(path / f"{k}.png")
    (path / "density.txt").write_text("data0 300")
    return path
