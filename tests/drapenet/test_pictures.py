"""Pictures of depth views: their scale, their order, and their symmetries."""

from itertools import product

import numpy as np
import pytest
from cloths import skirt

from data.render.cameras import Camera, camera_pose, nominal_camera
from data.render.rays import DepthRenderer
from drapenet.network.targets import QUARTER, Symmetry
from drapenet.views.located import LocatedViews
from drapenet.views.pictures import DepthPictures
from sim.rig import Rig

RIG = Rig()
CLOTH = skirt(edge=0.012)  # none of its symmetries
QUARTERS = np.arange(4) * np.pi / 2


def pictures(
    positions: np.ndarray = CLOTH.positions, *, warp: float = 0.3, turns: np.ndarray = QUARTERS,
    camera: Camera | None = None, rig: Rig = RIG,
) -> DepthPictures:
    """Of cloth whose azimuth 0 is in the direction ``warp`` in the first view."""
    camera = camera or nominal_camera(rig)
    views = DepthRenderer(positions, CLOTH.faces).views(camera, warp, turns)
    return DepthPictures.of(LocatedViews.exact(views, camera, rig, turns), warp)


def alike(one: np.ndarray, other: np.ndarray) -> float:
    """Share of pixels that are equal within 0.6 mm of 300 mm, or both empty."""
    same = np.isclose(one.astype(float), other.astype(float), atol=2e-3, equal_nan=True)
    return float(same.mean())


def test_depth_is_counted_from_the_plate_in_sizes():
    found = pictures().depth.astype(float)
    assert np.isfinite(found).mean(axis=(1, 2)).min() > 0.15
    assert abs(np.nanmedian(found)) < 0.2 and np.nanmax(np.abs(found)) < 0.6
    border = np.concatenate([found[:, 0], found[:, -1], found[:, :, 0], found[:, :, -1]])
    assert np.isnan(border).all()  # the whole cloth is inside


def test_pictures_do_not_depend_on_the_picture_size_or_the_focal_length():
    there = nominal_camera()
    finer = there.resized(480, 360)
    wider = Camera(0.8 * there.fx, 0.8 * there.fy, there.cx, there.cy, there.width, there.height,
                   there.world_to_camera)
    for camera in (finer, wider):
        assert alike(pictures().depth, pictures(camera=camera).depth) > 0.93
    aside = Camera(there.fx, there.fy, there.cx, there.cy, there.width, there.height, camera_pose(
        distance=0.55, pitch=np.radians(55), above=0.036))
    assert alike(pictures().depth, pictures(camera=aside).depth) < 0.9


def test_pictures_of_a_specimen_of_twice_the_size_are_the_same():
    large = Rig((0.6, 0.6), 0.2)
    found = pictures(2 * CLOTH.positions, rig=large)
    assert alike(pictures().depth, found.depth) > 0.97


@pytest.mark.parametrize("warp", [0.3, 1.9, -2.0])
def test_the_first_picture_has_azimuth_0_nearest_to_the_right(warp):
    """A view further on is the same picture, so that its number does not matter."""
    found, later = (pictures(warp=warp + shift) for shift in (0.0, np.pi / 2))
    assert abs(found.angle) <= np.pi / 4
    assert (warp - found.angle) / (np.pi / 2) == pytest.approx(round(warp / (np.pi / 2)))
    assert later.angle == pytest.approx(found.angle)
    assert alike(found.depth, later.depth) > 0.99


def test_views_between_quarter_turns_are_left_out():
    four = pictures().depth
    eight = pictures(turns=np.arange(8) * np.pi / 4).depth
    np.testing.assert_array_equal(four, eight)
    one = pictures(turns=np.zeros(1), warp=0.3 + np.pi / 2).depth
    np.testing.assert_array_equal(one[1], pictures(warp=0.3 + np.pi / 2).depth[1])
    assert np.isnan(one[[0, 2, 3]]).all()
    three = pictures(turns=np.arange(3) * 2 * np.pi / 3).depth
    assert np.isfinite(three).any(axis=(1, 2)).tolist() == [True, False, False, False]


@pytest.mark.parametrize(("quarters", "mirror"), list(product(range(4), (False, True))))
def test_symmetries_of_pictures_are_those_of_the_specimen(quarters, mirror):
    """As of maps: the specimen is reflected at azimuth 0, then turned from azimuth 0."""
    symmetry = Symmetry(np.array([quarters * QUARTER]), np.array([mirror]))
    seen = pictures()
    found = symmetry.of_pictures(seen.depth[None])[0]
    angle = symmetry.of_angles(np.array([seen.angle])).item()
    turn = np.linalg.matrix_power(np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]), quarters)
    moved = CLOTH.positions * ([1, -1, 1] if mirror else 1) @ turn.T
    expected = pictures(moved, warp=-0.3 if mirror else 0.3)
    assert angle == pytest.approx(expected.angle)
    assert alike(found, expected.depth) > 0.98
    assert alike(seen.depth, found) < 0.95 or (quarters, mirror) == (0, False)
