"""Cameras, their places in setups, and boards in their pictures."""

import io
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from cloths import varied_camera
from PIL import Image

from common.errors import InputError
from data.captures.board import PAPER, board_intrinsics, board_picture, board_turns, shows_board
from data.captures.description import Description
from data.captures.frames import read_frames
from data.captures.plate import plate_of_cloth
from data.captures.reader import read_capture
from data.render.cameras import Camera, Intrinsics, camera_pose, nominal_camera
from data.render.setups import Setups, SyntheticCapture
from sim.rig import DISC_RIG, SQUARE_RIG, Rig

CAPTURES = Path(__file__).resolve().parents[3] / "shared" / "captures"
INTRINSICS = Intrinsics(fx=610.0, fy=610.0, cx=319.5, cy=239.5, width=640, height=480)
DESCRIPTION = Description(density_g_m2=150.0)
TURNS = np.radians([0.0, 87.0, 181.5, 271.0])
TABLE = -0.22  # m, below the plate
REAL = Setups.load()
CLEAN = replace(REAL, sensors={"none": 1.0}, border=0, holes=0, hem_share=0.0, turn=0.0, focal=0.0)


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


@pytest.mark.skipif(not CAPTURES.is_dir(), reason="the published captures are not here")
@pytest.mark.parametrize("name", ["mesh0", "mesh1"])
def test_published_captures_agree_with_the_nominal_camera(nominal, name):
    for view in read_capture(CAPTURES / name).views:
        plate = plate_of_cloth(view[None], nominal, Rig())
        pitch, roll = np.arcsin(-plate.normal[2]), np.arctan2(plate.normal[0], -plate.normal[1])
        assert abs(np.degrees(pitch) - 38) < 2 and abs(np.degrees(roll)) < 5
        assert abs(np.linalg.norm(plate.centre) - 0.527) < 0.02
        assert abs(plate.centre[0]) < 0.04 and abs(-plate.centre[1] - 0.036) < 0.036


@pytest.fixture(scope="module")
def pictures() -> np.ndarray:
    """(4, 480, 640) uint8 of the sheet, beside the column of a table that turns."""
    sheet = np.array(Image.open(io.BytesIO(board_picture())))
    to_camera = camera_pose(distance=0.75, pitch=np.radians(40.0), above=0.1)
    height, width = sheet.shape
    pixels = np.array([[0, 0], [width, 0], [width, height], [0, height]], np.float32)
    flat = (pixels / [width, height] - 0.5) * PAPER * [1, -1]  # the sheet's top away from us
    found = []
    for turn in TURNS:
        cos, sin = np.cos(turn), np.sin(turn)
        x, y = (flat + np.array([0.02, -0.06])).T
        world = np.column_stack([x * cos - y * sin, x * sin + y * cos, np.full(4, TABLE)])
        camera = world @ to_camera[:3, :3].T + to_camera[:3, 3]
        seen = camera[:, :2] / camera[:, 2:] * INTRINSICS.fx + [INTRINSICS.cx, INTRINSICS.cy]
        homography = cv2.getPerspectiveTransform(pixels, seen.astype(np.float32))
        large = cv2.warpPerspective(sheet, np.diag([2.0, 2.0, 1.0]) @ homography, (1280, 960),
                                    borderValue=90, flags=cv2.INTER_AREA)
        found.append(cv2.resize(large, (640, 480), interpolation=cv2.INTER_AREA))
    return np.stack(found)


def test_turns_of_the_table_are_those_of_the_board(pictures):
    found = board_turns(pictures, INTRINSICS)
    assert np.degrees(found) == pytest.approx(np.degrees(TURNS), abs=0.5)


def test_the_focal_length_is_that_of_the_camera(pictures):
    found = board_intrinsics(pictures)
    assert found.fx == pytest.approx(INTRINSICS.fx, rel=0.03) and found.fy == found.fx
    assert (found.width, found.height) == (640, 480)


def test_pictures_without_a_board_are_refused(pictures):
    blank = pictures.copy()
    blank[2] = 90
    assert shows_board(blank) and not shows_board(blank[2:3])
    with pytest.raises(InputError, match=r"color_2.png does not show the board"):
        board_turns(blank, INTRINSICS)


def test_the_sheet_is_a4_with_its_true_size(pictures):
    with Image.open(io.BytesIO(board_picture())) as sheet:
        assert sheet.info["dpi"][0] == pytest.approx(300, abs=0.1)
        assert sheet.size == (2480, 3508)


def test_colour_pictures_come_with_the_frames(pictures, tmp_path):
    depth = np.full((480, 640), 700, np.uint16)
    for k, picture in enumerate(pictures):
        Image.fromarray(depth + k * (np.indices(depth.shape)[0] > 9).astype(np.uint16)).save(
            tmp_path / f"view_{k}.png")
        Image.fromarray(np.repeat(picture[..., None], 3, axis=2)).save(tmp_path / f"color_{k}.png")
    found = read_frames(tmp_path, DESCRIPTION)
    assert np.array_equal(found.color, pictures)
    (tmp_path / "color_3.png").unlink()
    with pytest.raises(InputError, match="3 color pictures of 640x480 pixels but 4 views"):
        read_frames(tmp_path, DESCRIPTION)


def capture(setups: Setups, drape: SimpleNamespace, seed: int) -> SyntheticCapture:
    return setups.capture(drape.positions, drape.faces, np.random.default_rng(seed))


def test_a_capture_is_its_seed_s(skirted):
    one, again, other = (capture(REAL, skirted, seed) for seed in (1, 1, 2))
    assert np.array_equal(one.views, again.views) and one.intrinsics == again.intrinsics
    assert one.views.shape != other.views.shape or not np.array_equal(one.views, other.views)


def test_cameras_stand_where_they_may_and_see_the_specimen(skirted):
    pitches, distances, cut = [], [], []
    for seed in range(20):
        found = capture(replace(CLEAN, views=(0, 0, 0, 1, 0, 0, 0, 0)), skirted, seed)
        cloth = found.views > 0
        cut.append(cloth[:, [0, -1]].any() or cloth[:, :, [0, -1]].any())
        assert cloth.any(axis=(1, 2)).all()
        plate = plate_of_cloth(found.views, found.intrinsics, Rig())
        pitches.append(np.arcsin(-plate.normal[2]))
        distances.append(np.linalg.norm(plate.centre))
    for values, (low, high) in ((pitches, REAL.pitch), (distances, REAL.distance)):
        margin = 0.05 * (high - low)
        assert low - margin < min(values) < low + 6 * margin
        assert high - 6 * margin < max(values) < high + margin
    assert np.mean(cut) < 0.4  # the corners of a wide drape leave the picture


def test_shares_are_those_asked_for(skirted):
    small = replace(CLEAN, views=(0.5, 0.5, 0, 0, 0, 0, 0, 0))
    counts = [len(capture(small, skirted, seed).views) for seed in range(40)]
    assert set(counts) == {1, 2} and 0.3 < np.mean(np.array(counts) == 1) < 0.7


def test_a_cut_out_takes_cloth_away_and_adds_none(skirted):
    spoilt = replace(CLEAN, border=2, holes=3, hem_share=1.0)
    less = []
    for seed in range(12):
        # The same camera, as all that is drawn before the cut-out is the same.
        whole, cut = (capture(setups, skirted, seed).views for setups in (CLEAN, spoilt))
        assert np.array_equal(cut[cut > 0], whole[cut > 0])
        less.append((cut > 0).sum() / (whole > 0).sum())
    assert 0.7 < min(less) < 0.97 and max(less) <= 1.0


def test_a_longer_lens_is_given_with_its_error(skirted):
    wrong = [capture(replace(CLEAN, focal=0.02), skirted, seed).intrinsics.fx
             / capture(CLEAN, skirted, seed).intrinsics.fx for seed in range(60)]
    assert np.std(wrong) == pytest.approx(0.02, rel=0.3)
