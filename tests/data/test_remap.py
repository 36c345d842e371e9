"""Resampling keeps surfaces exact and silhouettes unmixed."""

import numpy as np
import torch

from data.render import remap
from data.render.remap import EDGE_STEP


def remap_depth(*arrays: np.ndarray) -> np.ndarray:
    return remap.remap_depth(*(torch.from_numpy(array) for array in arrays)).numpy()


def grid(height: int, width: int) -> tuple[np.ndarray, np.ndarray]:
    v, u = np.mgrid[:height, :width].astype(float)
    return u, v


def test_identity_returns_the_picture():
    depth = np.random.default_rng(0).uniform(0.4, 0.6, (2, 3, 20, 30)).astype(np.float32)
    depth[depth < 0.45] = 0
    u, v = grid(20, 30)
    assert (remap_depth(depth, u, v) == depth).all()


def test_a_linear_surface_is_reproduced_between_pixels():
    u, v = grid(20, 30)
    depth = (0.5 + 0.002 * u - 0.003 * v).astype(np.float32)
    shifted = remap_depth(depth, u[2:-2, 2:-2] + 0.37, v[2:-2, 2:-2] - 0.81)
    exact = 0.5 + 0.002 * (u[2:-2, 2:-2] + 0.37) - 0.003 * (v[2:-2, 2:-2] - 0.81)
    assert np.abs(shifted - exact).max() < 1e-6


def test_silhouettes_take_the_nearest_pixel_and_mix_nothing():
    u, v = grid(10, 12)
    depth = np.zeros((10, 12), dtype=np.float32)
    depth[:, 3:6] = 0.5
    depth[:, 6:9] = 0.5 + 3 * EDGE_STEP
    moved = remap_depth(depth, u + 0.4, v)
    assert (moved == depth).all()
    moved = remap_depth(depth, u + 0.6, v)
    assert (moved[:, :-1] == depth[:, 1:]).all()


def test_outside_of_the_picture_is_background():
    u, v = grid(6, 8)
    depth = np.full((6, 8), 0.5, dtype=np.float32)
    moved = remap_depth(depth, u - 3, v + 100)
    assert not moved.any()
    moved = remap_depth(depth, u - 3, v)
    assert not moved[:, :3].any() and (moved[:, 3:] == 0.5).all()


def test_each_picture_of_a_batch_has_its_own_coordinates():
    depth = np.random.default_rng(1).uniform(0.50, 0.51, (3, 8, 9)).astype(np.float32)
    u, v = grid(8, 9)
    shift = np.array([0.0, 1.0, -2.0])[:, None, None]
    moved = remap_depth(depth, u + shift, v)
    assert (moved[0] == depth[0]).all()
    assert (moved[1, :, :-1] == depth[1, :, 1:]).all()
    assert (moved[2, :, 2:] == depth[2, :, :-2]).all()
