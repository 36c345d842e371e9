"""The edge of cloth in a photograph, to a fraction of a pixel."""

import cv2
import numpy as np
from scipy.ndimage import gaussian_filter1d

from common.errors import InputError
from common.types import LinearLight, Mask, PixelPath

FLOOR = 0.01  # of light, below which noise rules
_BLUR = 1.6  # pixels, standard deviation
_BAND, _BANDS = 4.0, (4.0, 20.0)  # errors of a border, within which the edge is looked for; pixels
_FINE = 0.5  # pixels, between places across the border
_STRONG = 0.3  # of a usual edge, whose cost is half of that of none
_AWAY = 0.3  # cost at the band's ends
_STEP_COST, _STEEPEST = 0.7, 2  # of a pixel across; places
_NEAR, _EVEN = 2.0, 1.0  # pixels: across, over which an edge is centred, and along, smoothed
_ROUNDS = 5
_ACROSS = 3.0  # pixels, on both sides of an edge, between which its contrast is measured


def smoothed(light: LinearLight) -> LinearLight:
    """Light without noise, as edges are looked for in it."""
    return cv2.GaussianBlur(light, (0, 0), _BLUR)


def edge_of(
    smooth: LinearLight, border: PixelPath, error: np.ndarray, unsure: Mask | None = None
) -> tuple[PixelPath, np.ndarray]:
    """The closed line along which light, :func:`smoothed`, changes most, near a ``border`` whose
    points are a pixel apart and have an ``error`` (N,), pixels; and the contrast (N,) across it, of
    log light, 0 where edges are ``unsure``.

    It is the shortest path around in a band: a stronger edge costs less, and so does a path that
    keeps its distance from the border, which it follows where edges are unsure.
    """
    normal = normals(border)
    band = np.clip(_BAND * float(np.quantile(error, 0.9)), *_BANDS)
    offsets = np.arange(-band, band + _FINE / 2, _FINE)
    places = border[:, None] + offsets[:, None] * normal[:, None]
    across = sampled(smooth, places)
    change = _change(np.sqrt(across + FLOOR))
    usual = max(float(np.median(change.max(axis=1))), 1e-6)
    cost = 1 / (1 + np.square(change / (_STRONG * usual)))
    weight = np.square(_change(across))
    if unsure is not None:
        hidden = sampled(unsure.astype(np.float32), places) > 0.01
        cost[hidden], weight[hidden] = 1.0, 0.0
    path = _shortest(cost + _AWAY * np.square(offsets / (_BAND * error[:, None])))
    found = offsets[path]
    for _ in range(_ROUNDS):  # to the middle of the edge, where light is half way
        near = weight * np.exp(-np.square((offsets - found[:, None]) / _NEAR))
        total = near.sum(axis=1)
        found = np.where(total > 0, (near @ offsets) / np.maximum(total, 1e-12), found)
    line = border + gaussian_filter1d(found, _EVEN, mode="wrap")[:, None] * normal
    sides = line[:, None] + _ACROSS * np.array([[1], [-1]]) * normal[:, None]
    contrast = np.diff(sampled(np.log(smooth + FLOOR), sides), axis=1)[:, 0]
    contrast = np.linalg.norm(gaussian_filter1d(contrast, _ACROSS, axis=0, mode="wrap"), axis=1)
    if unsure is not None:
        contrast[sampled(unsure.astype(np.float32), line[:, None])[:, 0] > 0.01] = 0.0
    return line, contrast


def border_of(cloth: Mask, smooth: float) -> PixelPath:
    """Points a pixel apart along the smoothed border of a mask."""
    outer, _ = cv2.findContours(cloth.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    largest = max(outer, key=cv2.contourArea)[:, 0].astype(float)
    if len(largest) < 8 * smooth:
        raise InputError("no drape was found, but lines; use a plain ground")
    even = gaussian_filter1d(spaced(largest, 1.0), smooth, axis=0, mode="wrap")
    return spaced(even, 1.0)


def spaced(line: PixelPath, step: float) -> PixelPath:
    """Points on a closed line about a ``step`` apart."""
    closed = np.vstack([line, line[:1]])
    length = np.append(0, np.cumsum(np.linalg.norm(np.diff(closed, axis=0), axis=1)))
    places = np.linspace(0, length[-1], max(round(length[-1] / step), 3), endpoint=False)
    return np.column_stack([np.interp(places, length, column) for column in closed.T])


def normals(line: PixelPath) -> PixelPath:
    """Outward normals of a closed line."""
    along = np.roll(line, -2, axis=0) - np.roll(line, 2, axis=0)
    normal = along[:, ::-1] * [1, -1] / np.maximum(np.linalg.norm(along, axis=1), 1e-9)[:, None]
    return normal * np.sign(cv2.contourArea(line.astype(np.float32), oriented=True))


def sampled(values: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Values (N, M, ...) of a picture (H, W, ...) at places (N, M, 2), between its pixels."""
    columns, rows = np.moveaxis(places, 2, 0).astype(np.float32)
    return cv2.remap(values, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)


def _change(across: np.ndarray) -> np.ndarray:
    """Change (N, M) of values (N, M, 3) along lines."""
    return np.linalg.norm(np.gradient(across, axis=1), axis=2)


def _shortest(cost: np.ndarray) -> np.ndarray:
    """Columns (N,) of the closed path through all rows of a cost (N, M) whose cost, with that of
    its steps between columns, is least."""
    count, width = cost.shape
    steps = np.arange(-_STEEPEST, _STEEPEST + 1)
    price = _STEP_COST * _FINE * np.abs(steps)
    best = np.zeros(width)
    chosen = np.zeros((2 * count, width), int)
    for row in range(2 * count):  # the second turn does not know where the first began
        padded = np.pad(best, _STEEPEST, constant_values=np.inf)
        options = np.stack([padded[_STEEPEST + step : _STEEPEST + step + width] for step in steps])
        options += price[:, None]
        chosen[row] = options.argmin(axis=0)
        best = options[chosen[row], np.arange(width)] + cost[row % count]
    path = np.zeros(2 * count, int)
    path[-1] = best.argmin()
    for row in range(2 * count - 1, 0, -1):
        path[row - 1] = path[row] + steps[chosen[row][path[row]]]
    return np.roll(path[count // 2 : count // 2 + count], count // 2)
