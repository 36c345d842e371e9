"""Camera conventions, and the agreement of the nominal camera with the published captures."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from cloths import varied_camera

from common.errors import InputError
from data.captures.plate import plate_of_cloth
from data.captures.reader import read_capture
from data.render.cameras import Camera, Intrinsics, camera_pose, nominal_camera
from data.render.setups import Setups
from sim.rig import DISC_RIG, SQUARE_RIG, Rig

CAPTURES = Path(__file__).resolve().parents[3] / "shared" / "captures"


def position(camera: Camera) -> np.ndarray:
    """Optical centre in the world, (3,) m."""
    return np.linalg.inv(camera.world_to_camera)[:3, 3]


@pytest.fixture(scope="module")
def nominal() -> Camera:
    return nominal_camera()


def test_nominal_camera_sees_the_plate_where_the_rig_says(nominal):
    (pixel,), (depth,) = nominal.project(np.zeros((1, 3)))
    assert np.linalg.norm(position(nominal)) == pytest.approx(0.527, abs=1e-12)
    assert depth == pytest.approx(np.sqrt(0.527**2 - 0.036**2), abs=1e-12)
    assert pixel == pytest.approx([119.5, 89.5 - 305.0 * 0.036 / depth], abs=1e-9)


def test_camera_stands_in_front_above_and_looks_down(nominal):
    camera = nominal
    assert abs(position(camera)[0]) < 1e-12
    assert position(camera)[1] < -0.3 and position(camera)[2] > 0.2
    axis = camera.world_to_camera[2, :3]
    assert np.degrees(np.arcsin(-axis[2])) == pytest.approx(38.0)
    rotation = camera.world_to_camera[:3, :3]
    assert rotation @ rotation.T == pytest.approx(np.eye(3), abs=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1.0)


def test_positive_roll_turns_the_content_clockwise(nominal):
    pose = camera_pose(distance=0.5, pitch=0.6, roll=np.radians(5.0))
    camera = replace(nominal, world_to_camera=pose)
    (foot, tip), _ = camera.project(np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.05]]))
    lean = np.degrees(np.arctan2(tip[0] - foot[0], foot[1] - tip[1]))
    assert lean == pytest.approx(5.0, abs=1e-6)


def test_offsets_move_the_plate_across_the_picture():
    pose = camera_pose(distance=0.5, pitch=0.6, above=0.04, aside=-0.03, roll=0.05)
    centre = pose @ [0, 0, 0, 1]
    assert centre[:2] == pytest.approx([-0.03, -0.04])
    assert np.linalg.norm(centre[:3]) == pytest.approx(0.5)


def test_pixel_centres_lie_on_whole_numbers():
    camera = varied_camera(np.random.default_rng(3))
    depth = np.full((camera.height, camera.width), 0.5)
    local = camera.back_project(depth)
    assert (local[..., 2] == 0.5).all()
    row, column = 17, 203
    rotation, shift = camera.world_to_camera[:3, :3], camera.world_to_camera[:3, 3]
    world = (local[row, column] - shift) @ rotation
    (pixel,), (z,) = camera.project(world[None])
    assert pixel == pytest.approx([column, row], abs=1e-9) and z == pytest.approx(0.5)


def test_resized_keeps_the_corners_of_the_picture():
    camera = varied_camera(np.random.default_rng(4))
    small = camera.resized(120, 90)
    point = np.array([[0.03, -0.02, -0.06]])
    (large_px,), _ = camera.project(point)
    (small_px,), _ = small.project(point)
    assert (small_px + 0.5) * 2 == pytest.approx(large_px + 0.5, abs=1e-9)
    assert (small.width, small.height) == (120, 90)


@pytest.mark.parametrize("name", ["disc200_support100", "disc400_support200",
                                  "square400_cylinder60"])
def test_pictures_of_specimens_of_all_sizes_look_alike(name):
    tester = Rig.from_name(name)
    measured = DISC_RIG if tester.specimen == "disc" else SQUARE_RIG
    ring = np.array([[np.cos(a), np.sin(a), -0.1] for a in np.linspace(0, 6, 9)])
    pixels, expected = (
        nominal_camera(rig).project(rig.reach * ring)[0]
        for rig in (tester, measured))
    assert np.allclose(pixels, expected, atol=1e-6)
    pixels, expected = (Setups.load().camera(np.random.default_rng(3), rig)
                        for rig in (tester, measured))
    assert pixels.fx * tester.reach == pytest.approx(expected.fx * measured.reach)


def test_unusable_intrinsics_are_input_errors():
    with pytest.raises(InputError, match="positive focal"):
        Intrinsics(fx=-300, fy=300, cx=119.5, cy=89.5, width=240, height=180)
    with pytest.raises(InputError, match="inner part of the 120x90"):
        Intrinsics(fx=300, fy=300, cx=119.5, cy=89.5, width=120, height=90)


@pytest.mark.skipif(not CAPTURES.is_dir(), reason="the published captures are not here")
@pytest.mark.parametrize("name", ["mesh0", "mesh1"])
def test_published_captures_agree_with_the_nominal_camera(nominal, name):
    for view in read_capture(CAPTURES / name).views:
        plate = plate_of_cloth(view[None], nominal, Rig())
        pitch, roll = np.arcsin(-plate.normal[2]), np.arctan2(plate.normal[0], -plate.normal[1])
        assert abs(np.degrees(pitch) - 38) < 2 and abs(np.degrees(roll)) < 5
        assert abs(np.linalg.norm(plate.centre) - 0.527) < 0.02
        assert abs(plate.centre[0]) < 0.04 and abs(-plate.centre[1] - 0.036) < 0.036
