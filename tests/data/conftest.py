"""Captures that a test may spoil."""

from pathlib import Path

import numpy as np
import pytest
from cloths import revolved
from PIL import Image

from data.captures.writer import write_capture
from data.render.cameras import nominal_camera
from data.render.rays import DepthRenderer
from sim.rig import SQUARE_RIG


@pytest.fixture(scope="session")
def views() -> np.ndarray:
    """Of a plate with a lopsided skirt, by the nominal camera."""
    hem = 0.08 + 0.02 * np.cos(2 * np.pi * np.arange(24) / 24)
    radius = np.array([0 * hem, np.full(24, 0.05), hem])
    cone = revolved(radius, np.array([0, 0, -0.09]), around=24)
    return DepthRenderer(*cone).views(nominal_camera(), 0.3)


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
