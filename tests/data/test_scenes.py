"""Synthetic raw scenes: what stands where, and which pixels show cloth."""

import numpy as np
import pytest

from data.render.scenes import CLUTTER, raw_scene
from sim.rig import Rig

TURNS = np.radians([0.0, 83.0, 184.0, 271.0])


def scene(skirted, seed=0, **settings):
    return raw_scene(skirted.positions, skirted.faces, np.random.default_rng(seed), rig=Rig(),
                     turns=TURNS, **settings)


def test_cloth_is_what_changes_and_lies_before_everything_else(skirted):
    seen = scene(skirted, sensor="none")
    assert seen.frames.shape == (4, 180, 240) and (seen.frames > 0).mean() > 0.9
    assert np.array_equal(seen.frames[seen.cloth], seen.clean[seen.cloth])
    nothing = np.broadcast_to(seen.background, seen.frames.shape)
    assert np.array_equal(seen.frames[~seen.cloth], nothing[~seen.cloth])
    known = seen.cloth & (nothing > 0)
    assert (seen.frames[known] <= nothing[known]).all()
    # Nothing stands between the camera and the cloth.
    assert (seen.cloth == (seen.clean > 0)).all()


def test_the_table_lies_as_far_below_the_plate_as_is_said(skirted):
    seen = scene(skirted, sensor="none", clutter="empty")
    pose = seen.camera.world_to_camera
    points = (seen.camera.back_project(seen.background) - pose[:3, 3]) @ pose[:3, :3]
    near = (points[..., 1] < 0.3) & (np.hypot(points[..., 0], points[..., 1]) > 0.06)
    near &= seen.background > 0
    assert near.sum() > 1000
    assert np.allclose(points[near][:, 2], seen.table, atol=1e-4)


def test_clutter_fills_the_scene_and_the_seed_decides(skirted):
    shares = []
    for name in CLUTTER:
        empty, full = (scene(skirted, sensor="none", clutter=one) for one in ("empty", name))
        shares.append((empty.background != full.background).mean())
    assert shares[0] == 0 and shares[2] > 0.05
    assert np.array_equal(scene(skirted, seed=3).frames, scene(skirted, seed=3).frames)


@pytest.mark.parametrize("sensor", ["smooth", "paper"])
def test_the_label_goes_through_the_sensor_with_the_depth(skirted, sensor):
    seen = scene(skirted, sensor=sensor, clutter="empty")
    # It is displaced with the picture: a label left where it was would be wrong at silhouettes.
    pose = seen.camera.world_to_camera
    height = ((seen.camera.back_project(seen.frames) - pose[:3, 3]) @ pose[:3, :3])[..., 2]
    assert (height[seen.cloth] > seen.table + 0.03).mean() > 0.999
    assert (seen.cloth != (seen.clean > 0)).any()
