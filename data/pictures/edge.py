"""The edge of cloth in a photograph, to a fraction of a pixel."""

import cv2
import numpy as np
from scipy.ndimage import gaussian_filter1d

from common.errors import InputError
from common.types import LinearLight, Mask, PixelPath

FLOOR = 0.01  # of light, below which noise rules
_BLUR = 1.6  # pixels, standard deviation
_WINDOW, _WINDOWS = 1.2, (1.5, 12.0)  # errors of a border, about it, and pixels
_FINE = 0.5  # pixels, between places across the border
_STAY, _NARROW = (2.0, 0.05), 2.0  # of a usual edge, that keep a point; pixels, last window
_ROUNDS, _EVEN = 4, (1.5, 0.3)  # moves of a point; their smoothing along the line, in `scale`
_ACROSS = 3.0  # pixels, on both sides of an edge, between which its contrast is measured


def smoothed(light: LinearLight) -> LinearLight:
    """Light without noise, as edges are looked for in it."""
    return cv2.GaussianBlur(light, (0, 0), _BLUR)


def edge_of(
    smooth: LinearLight, border: PixelPath, error: np.ndarray, unsure: Mask | None = None, *,
    scale: float
) -> tuple[PixelPath, np.ndarray]:
    """The closed line along which light, :func:`smoothed`, changes most, near a ``border`` whose
    points are about a pixel apart and have an ``error`` (N,), pixels; and the contrast (N,) across
    it, of log light, 0 where edges are ``unsure``. ``scale``: pixels, of the border's coarseness.

    Each point moves to the middle of the changes about it, weighted by their squares, then to that
    of the nearest; where they are faint or unsure, it stays.
    """
    normal = normals(border)
    window = np.clip(_WINDOW * error, *_WINDOWS)[:, None]
    end = np.ceil(2 * window.max())
    offsets = np.arange(-end, end + _FINE / 2, _FINE)
    places = border[:, None] + offsets[:, None] * normal[:, None]
    across = sampled(smooth, places)
    allowed = np.exp(-np.square(offsets / (2 * window)))
    if unsure is not None:
        allowed[sampled(unsure.astype(np.float32), places) > 0.01] = 0.0
    found = np.zeros(len(border))
    # Dark edges count by their contrast; the middle of an edge is where light is half way.
    for light, wide, stay, even in zip(
            (np.sqrt(across + FLOOR), across), (window, np.full_like(window, _NARROW)), _STAY,
            _EVEN, strict=True):
        weight, start = allowed * np.square(_change(light)), found
        held = stay * max(float(np.median(weight.max(axis=1))), 1e-12)
        for _ in range(_ROUNDS):
            near = weight * np.exp(-np.square((offsets - found[:, None]) / wide))
            found = gaussian_filter1d((near @ offsets + held * start) / (near.sum(axis=1) + held),
                                      even * scale, mode="wrap")
    line = border + found[:, None] * normal
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
