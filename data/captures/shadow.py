"""The outline of a drape in a photograph from above, to a fraction of a pixel.

The cloth is darker or lighter than a plain ground. Half way between the brightness of the cloth and
that of the ground nearby, its edge is located.
"""

from pathlib import Path
from typing import Any

import contourpy
import cv2
import numpy as np
from PIL import Image, ImageOps

from common.documents import reading, require_regular
from common.errors import InputError
from common.types import Mask, Pixels

MAX_FILE_BYTES = 160 << 20
SIDES = (100, 10_000)  # pixels
WORKING_SIDE = 1500  # pixels, to which larger photographs are reduced
BLUR = 1.2  # pixels, standard deviation
_BAND = np.ones((9, 9), np.uint8)  # the edge, blurred
_NEARBY = 1 / 12  # of a side: window in which the brightness is averaged
MIN_CONTRAST = 0.12  # between cloth and ground, of the brightest
MIN_SHARE = 0.01  # of the picture's pixels
PIECE_SHARE = 0.05  # of the drape; smaller pieces are specks
FRAME_SHARE = 0.2  # of what a frame surrounds, at least its opening
CUT_OFF_SHARE = 0.2  # smaller pieces than this share of a piece at the border are not the drape


def read_grey(
    file: Path, *, side: int = WORKING_SIDE, brightest: float = 0.995
) -> tuple[np.ndarray, int]:
    """Brightness (H, W) float32, 0 to 255 for the quantile ``brightest``, with at most ``side``
    pixels on a side, and how many pixels of a row of the file have been averaged to each."""
    require_regular(file, MAX_FILE_BYTES, "photograph")
    with reading(file, "save it again as PNG, JPEG or TIFF"):
        with Image.open(file, formats=["PNG", "JPEG", "TIFF"]) as picture:
            width, height = picture.size
            if not SIDES[0] <= min(picture.size) <= max(picture.size) <= SIDES[1]:
                raise InputError(f"{width}x{height} pixels; photographs have {SIDES[0]} to "
                                 f"{SIDES[1]} on each side")
            picture = ImageOps.exif_transpose(picture)
            wide = picture.mode[0] in "IF"  # more than 8 bits
            grey = np.asarray(picture if wide else picture.convert("L"))
    factor = -(-max(grey.shape) // side)
    rows, columns = (n // factor for n in grey.shape)
    grey = grey[: rows * factor, : columns * factor].reshape(rows, factor, columns, factor)
    grey = np.nan_to_num(grey.mean(axis=(1, 3), dtype=np.float32))
    white = max(float(np.quantile(grey, brightest)), 1e-6)
    return np.clip(grey * (255 / white), 0, 255).astype(np.float32), factor


def cut_drape(grey: np.ndarray) -> Pixels:
    """The drape's outline in a picture (H, W) float32, 0 to 255, to a fraction of a pixel."""
    smooth = cv2.GaussianBlur(grey, (0, 0), BLUR)
    level, _ = cv2.threshold(smooth.astype(np.uint8), 0, 255, cv2.THRESH_OTSU)
    light = smooth > level
    mixed = light.any() and not light.all()
    contrast = float(smooth[light].mean() - smooth[~light].mean()) / 255 if mixed else 0.0
    if contrast < MIN_CONTRAST:
        raise InputError(f"cloth and ground differ by {contrast:.0%} of the brightest pixels, at "
                         f"least {MIN_CONTRAST:.0%} is needed; use a ground of another brightness, "
                         "or light from below")
    border = np.concatenate([light[0], light[-1], light[:, 0], light[:, -1]])
    drape, is_light = _drape(light, is_light=border.mean() < 0.5)
    cloth = light == is_light
    core, near = cv2.erode(drape, _BAND) > 0, cv2.dilate(drape, _BAND) > 0
    if not core.any():
        raise InputError("no drape was found, but lines; use a plain ground")
    middle = (_nearby(smooth, core & cloth) + _nearby(smooth, ~near & ~cloth)) / 2
    field = (smooth - middle) if is_light else (middle - smooth)
    field = np.where(core, np.abs(field), np.where(near, field, -np.abs(field)))
    lines: Any = contourpy.contour_generator(z=field).lines(0.0)
    return max(lines, key=lambda line: cv2.contourArea(line.astype(np.float32)))[:-1]


def _nearby(picture: np.ndarray, mask: Mask) -> np.ndarray:
    """Mean (H, W) of the pixels of ``mask`` in a window around each pixel, or of all of them."""
    size = (int(max(picture.shape) * _NEARBY),) * 2
    weight = cv2.blur(mask.astype(np.float32), size)
    total = cv2.blur(np.where(mask, picture, np.float32(0)), size)
    whole = picture[mask].mean() if mask.any() else picture.mean()
    return np.where(weight > 1e-3, total / np.maximum(weight, 1e-3), whole)


def _drape(light: Mask, *, is_light: bool) -> tuple[np.ndarray, bool]:
    """The drape (H, W) uint8 without holes, and whether it is light. ``is_light``: whether what
    differs from the border is; that may be a sheet of paper under the drape."""
    height, width = light.shape
    _, labels, stats, _ = cv2.connectedComponentsWithStats((light == is_light).astype(np.uint8))
    left, top, wide, high, areas = stats[1:].T
    share = areas.max(initial=0) / light.size
    if share < MIN_SHARE:
        raise InputError(f"no drape was found: the largest area that differs from the ground "
                         f"covers {share:.1%} of the picture, at least {MIN_SHARE:.0%} is needed; "
                         "move the camera nearer, or use a plain ground")
    filled = _filled(largest := labels == 1 + areas.argmax())
    _, openings, inner, _ = cv2.connectedComponentsWithStats(filled - largest)
    if inner[1:, 4].max(initial=0) > FRAME_SHARE * filled.sum():
        opening = openings == 1 + inner[1:, 4].argmax()
        return _drape(np.where(opening, light, is_light), is_light=not is_light)
    free = (left > 0) & (top > 0) & (left + wide < width) & (top + high < height)
    drape = np.where(free, areas, 0).max()
    if drape < CUT_OFF_SHARE * areas.max():
        raise InputError("the drape touches the border of the picture; move the camera up, or use "
                         "a ground that fills the picture")
    if (pieces := int((areas[free] > PIECE_SHARE * drape).sum())) > 1:
        raise InputError(f"{pieces} pieces differ from the ground, the drape must be the only one; "
                         "take away what is not cloth, or crop the picture")
    return _filled(labels == 1 + np.where(free, areas, 0).argmax()), is_light


def _filled(piece: Mask) -> np.ndarray:
    outer, _ = cv2.findContours(piece.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    return cv2.drawContours(np.zeros(piece.shape, np.uint8), outer, -1, 1, cv2.FILLED)
