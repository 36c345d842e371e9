"""The printed board: its turns and the focal length, from pictures of a known camera."""

import io

import cv2
import numpy as np
import pytest
from PIL import Image

from common.errors import InputError
from data.captures.board import PAPER, board_intrinsics, board_picture, board_turns, shows_board
from data.captures.description import Description
from data.captures.frames import read_frames
from data.render.cameras import Intrinsics, camera_pose

INTRINSICS = Intrinsics(fx=610.0, fy=610.0, cx=319.5, cy=239.5, width=640, height=480)
DESCRIPTION = Description(density_g_m2=150.0)
TURNS = np.radians([0.0, 87.0, 181.5, 271.0])
TABLE = -0.22  # m, below the plate


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
