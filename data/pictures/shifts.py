"""By how much the code lies beside where the markers have it: paper bends, taped parts shift."""

import cv2
import numpy as np
from scipy.ndimage import gaussian_filter

from common.types import Mask, Metres
from data.pictures.cut import Printed
from data.pictures.mat import FINE, code_page, mat_pixels
from data.pictures.planes import on_grid

DARKER = 0.5, 0.95  # than paper: grey and black, about
FLOOR = 1e-3  # added to light
MATCH = 0.6  # least correlation of a window with the code
_TILE, _SEARCH, _GAP, _EXPECTED = 20, 6, 12, 0.8  # pixels of 2 FINE: windows of code, their moves
_FIELD, _EVENLY = 8e-3, 2.0  # m, between places of moves, and their smoothing, of it
_CLEAR = 0.6  # of the contrast of most windows


def shifts_of(
    light: np.ndarray, to_pixels: np.ndarray, printed: Printed, reach: Metres, on_mat: np.ndarray
) -> tuple[np.ndarray, Mask]:
    """Shifts (A, R, 2), m, of the print, and where it is surely seen."""
    pixel, middle = 2 * FINE, printed.to_mat[:2, 2]
    times = printed.to_mat[0, 0]
    half = int(reach * times / pixel)
    steps = np.arange(-half, half + 1) * pixel
    places = middle + np.dstack(np.meshgrid(steps, -steps))
    seen = np.sqrt(sampled_light(light, places, to_pixels @ np.linalg.inv(printed.to_mat)) + FLOOR)
    grey, black = (cv2.remap(blurred(page, _EXPECTED), *mat_pixels(printed.mat, places, FINE),
                             cv2.INTER_LINEAR) for page in code_page(printed.mat)[0])
    page = np.sqrt(1 - DARKER[0] * grey - DARKER[1] * black)
    size = 2 * int(half * pixel / _FIELD) + 1
    found = []
    starts = range(_SEARCH, len(steps) - _TILE - _SEARCH, _GAP)
    for row in starts:
        for column in starts:
            tile = page[row : row + _TILE, column : column + _TILE]
            if tile.std() < 0.1:
                continue
            there = seen[row - _SEARCH : row + _TILE + _SEARCH,
                         column - _SEARCH : column + _TILE + _SEARCH]
            scores = cv2.matchTemplate(there, tile, cv2.TM_CCOEFF_NORMED)
            _, top, _, (x, y) = cv2.minMaxLoc(scores)
            if top < MATCH or not 0 < x < 2 * _SEARCH or not 0 < y < 2 * _SEARCH:
                continue
            move = [x - _SEARCH + _peak(scores[y, x - 1 : x + 2]),
                    _SEARCH - y - _peak(scores[y - 1 : y + 2, x])]
            place = (places[row + _TILE // 2, column + _TILE // 2] - middle) / _FIELD
            there = there[y : y + _TILE, x : x + _TILE]
            contrast = there.std() / there.mean() * tile.mean() / tile.std()
            found.append((*place + size // 2, *move, top, contrast))
    if not found:
        return np.zeros(on_mat.shape), np.ones(on_mat.shape[:2], bool)
    told = np.array(found)
    told = told[told[:, 5] > _CLEAR * np.quantile(told[:, 5], 0.9)]  # not seen through cloth
    weight, moves = np.zeros((size, size)), np.zeros((size, size, 2))
    at = tuple(np.rint(told[:, 1::-1]).astype(int).T)
    np.add.at(weight, at, told[:, 4])
    np.add.at(moves, at, told[:, 4:5] * pixel * told[:, 2:4])
    mean = moves.sum(axis=(0, 1)) / weight.sum()
    total = gaussian_filter(weight, _EVENLY, mode="nearest")[..., None] + 1e-6
    field = (np.stack([gaussian_filter(moves[..., k], _EVENLY, mode="nearest") for k in (0, 1)], -1)
             + 1e-6 * mean) / total
    where = ((on_mat - middle) / _FIELD + size // 2).astype(np.float32)
    near = gaussian_filter(weight, 0.7)
    moved, sure = (cv2.remap(one.astype(np.float32), where[..., 0], where[..., 1], cv2.INTER_LINEAR,
                             borderMode=cv2.BORDER_REPLICATE) for one in (field, near))
    return moved, sure > 0.12


def _peak(three: np.ndarray) -> float:
    """Where a parabola through values at -1, 0 and 1 is highest."""
    before, here, after = map(float, three)
    return 0.5 * (before - after) / (before - 2 * here + after) if here > min(
        before, after) else 0.0


def blurred(values: np.ndarray, sigma: float) -> np.ndarray:
    """Values (H, W, ...) smoothed, as 0 beyond their border."""
    return cv2.GaussianBlur(values, (0, 0), sigma, borderType=cv2.BORDER_CONSTANT)


def sampled_light(light: np.ndarray, places: np.ndarray, to_pixels: np.ndarray) -> np.ndarray:
    """Light at places (A, R, 2), as coarse as these are."""
    pixels = on_grid(places, to_pixels).astype(np.float32)
    step = float(np.linalg.norm(np.diff(pixels[0, pixels.shape[1] // 2 :][:2], axis=0)))
    smooth = cv2.GaussianBlur(light, (0, 0), 0.4 * step) if step > 1.3 else light
    return cv2.remap(smooth, pixels[..., 0], pixels[..., 1], cv2.INTER_LINEAR,
                     borderMode=cv2.BORDER_REPLICATE)
