"""Turns of the table and focal length from a ChArUco board in colour or infrared pictures.

The board lies beside the column; the pictures are ``color_0.png``, ``color_1.png`` and so on, with
the pixels of the depth frames. ``python -m apps.capture board=a4.png`` writes a board.
"""

import io

import cv2
import numpy as np
from PIL import Image

from common.errors import InputError
from common.types import GreyViews, Pixels, Points, Turns
from data.render.cameras import Intrinsics

SQUARES, SQUARE, MARKER = (5, 7), 38e-3, 30e-3  # columns and rows; side lengths, m
DPI = 300
PAPER = (210e-3, 297e-3)  # m, A4
MIN_CORNERS = 6
MAX_REPROJECTION_ERROR = 3.0  # pixels, root mean square over the corners
_DICTIONARY = cv2.aruco.DICT_4X4_50
_CALIBRATION_FLAGS = (
    cv2.CALIB_FIX_K1 | cv2.CALIB_FIX_K2 | cv2.CALIB_FIX_K3 | cv2.CALIB_ZERO_TANGENT_DIST
    | cv2.CALIB_FIX_PRINCIPAL_POINT | cv2.CALIB_FIX_ASPECT_RATIO | cv2.CALIB_USE_INTRINSIC_GUESS)


def board() -> cv2.aruco.CharucoBoard:
    """The ChArUco board that is printed and detected."""
    return cv2.aruco.CharucoBoard(SQUARES, SQUARE, MARKER,
                                  cv2.aruco.getPredefinedDictionary(_DICTIONARY))


def board_picture() -> bytes:
    """The board on an A4 page as PNG, to be printed at 100 % (squares of 38 mm)."""
    page, inner = ([round(length / 25.4e-3 * DPI) for length in lengths]
                   for lengths in (PAPER, [n * SQUARE for n in SQUARES]))
    picture = np.full(page[::-1], 255, np.uint8)
    left, top = ((outer - size) // 2 for outer, size in zip(page, inner, strict=True))
    picture[top : top + inner[1], left : left + inner[0]] = board().generateImage(tuple(inner))
    stream = io.BytesIO()
    Image.fromarray(picture).save(stream, format="PNG", dpi=(DPI, DPI))
    return stream.getvalue()


def find_corners(picture: np.ndarray) -> tuple[Points, Pixels] | None:
    """Corners on the board and in a picture (H, W) uint8; None for less than :data:`MIN_CORNERS`.
    """
    pattern = board()
    corners, numbers, _, _ = cv2.aruco.CharucoDetector(pattern).detectBoard(picture)
    if corners is None or len(corners) < MIN_CORNERS:
        return None
    # OpenCV takes the arrays that it gives, which its types do not say.
    on_board, pixels = pattern.matchImagePoints(corners, numbers)  # type: ignore[call-overload]
    return on_board.reshape(-1, 3), pixels.reshape(-1, 2)


def shows_board(pictures: GreyViews) -> bool:
    """Whether one of the pictures shows the board."""
    return any(find_corners(picture) is not None for picture in pictures)


def board_turns(pictures: GreyViews, intrinsics: Intrinsics) -> Turns:
    """Turns of the board since the first picture; InputError if it is not seen or does not fit."""
    matrix = np.array([[intrinsics.fx, 0, intrinsics.cx], [0, intrinsics.fy, intrinsics.cy],
                       [0, 0, 1.0]])
    poses = []
    for k, picture in enumerate(pictures):
        corners = _require_corners(picture, k)
        solved, turn, shift = cv2.solvePnP(*corners, matrix, None, flags=cv2.SOLVEPNP_IPPE)
        if solved:
            turn, shift = cv2.solvePnPRefineLM(*corners, matrix, None, turn, shift)
            projected, _ = cv2.projectPoints(corners[0], turn, shift, matrix, None)
            error = np.sqrt(np.square(projected.reshape(-1, 2) - corners[1]).sum(axis=1).mean())
        if not solved or error > MAX_REPROJECTION_ERROR:
            raise InputError(f"color_{k}.png: its corners do not fit a flat board with these "
                             "intrinsics; check fx, fy and that the print is flat")
        poses.append((cv2.Rodrigues(turn)[0], shift.ravel()))
    first, shift = poses[0]
    up = first[:, 2] * -np.sign(first[:, 2] @ shift)  # towards the camera
    return np.array([float(cv2.Rodrigues(pose @ first.T)[0].ravel() @ up) for pose, _ in poses]) % (
        2 * np.pi)


def board_intrinsics(pictures: GreyViews) -> Intrinsics:
    """Focal length from an inclined board; InputError for a picture without it.

    Assumes that the principal point is the picture's centre, that pixels are square and that there
    is no lens distortion: coplanar boards do not determine these.
    """
    height, width = pictures.shape[1:]
    corners = [_require_corners(picture, k) for k, picture in enumerate(pictures)]
    guess = np.array([[1.2 * width, 0, (width - 1) / 2], [0, 1.2 * width, (height - 1) / 2],
                      [0, 0, 1]])
    _, matrix, *_ = cv2.calibrateCamera(
        [points.astype(np.float32) for points, _ in corners], [pixels for _, pixels in corners],
        (width, height), guess, None, flags=_CALIBRATION_FLAGS)
    return Intrinsics(fx=float(matrix[0, 0]), fy=float(matrix[1, 1]), cx=float(matrix[0, 2]),
                      cy=float(matrix[1, 2]), width=width, height=height)


def _require_corners(picture: np.ndarray, k: int) -> tuple[Points, Pixels]:
    if (corners := find_corners(picture)) is None:
        raise InputError(f"color_{k}.png does not show the board (fewer than {MIN_CORNERS} "
                         "corners); place it in view, or remove the color pictures")
    return corners
