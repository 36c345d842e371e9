"""The edge of cloth in a photograph, to a fraction of a pixel."""

from typing import Any

import contourpy
import cv2
import numpy as np
from scipy.ndimage import map_coordinates

from common.errors import InputError
from common.types import LinearLight, Mask, PixelPath, Pixels
from data.pictures.cloth import FLOOR, SHADE_EDGES, SIDE, Scene, cut_cloth
from data.pictures.reading import Photograph

_BLUR = 1.6  # pixels, standard deviation
_BAND = 4.0  # pixels of the mask, on both sides of its edge, within which the edge is looked for
_NEARBY = 1 / 60  # of a side: half of the window over which light beside the edge is averaged
MIN_CONTRAST = 0.1  # of log light, across the edge
MAX_FAINT = 0.03  # of the edge's length, that may have less
_MIN_SEEN = 0.3  # of a line's points
_ACROSS = 3.0  # pixels, on both sides of an edge, between which its contrast is measured
_STEP = 2.0  # pixels


def outline_of_cloth(photograph: Photograph, scene: Scene, paper: Mask | None) -> PixelPath:
    """The outline of the cloth in a photograph and its ``scene``; InputError where cloth and ground
    are alike. ``paper``: see :func:`edge_of`."""
    found, fault = [], None
    for level in SHADE_EDGES:
        try:
            cloth = cut_cloth(scene, level)
            line = _seen(edge_of(photograph.light, cloth, paper), photograph.painted)
        except InputError as error:
            fault = fault or error
            continue
        found.append((faint_share(photograph.light, line, photograph.painted), line))
        if found[-1][0] < MAX_FAINT / 3:
            break
    if not found:
        assert fault
        raise fault
    share, line = min(found, key=lambda one: one[0])
    if share > MAX_FAINT:
        raise InputError(
            f"along {share:.0%} of the hem, the cloth is as light as the ground, at most "
            f"{MAX_FAINT:.0%} is possible: use light from below, or a ground of another colour, and"
            " lamps that cast no shadow beside the cloth")
    return line


def _seen(line: PixelPath, painted: Mask | None) -> PixelPath:
    """A line that is straight where the picture is painted over."""
    if painted is None:
        return line
    seen = ~within(line, painted)
    if seen.mean() < _MIN_SEEN:
        return line
    places = np.arange(len(line))
    return np.column_stack([np.interp(places, places[seen], column[seen], period=len(line))
                            for column in line.T])


def faint_share(light: LinearLight, line: PixelPath, painted: Mask | None = None) -> float:
    """Share of a closed line along which light changes little across it, of what is not painted."""
    closed = np.vstack([line, line[:1]])
    length = np.append(0, np.cumsum(np.linalg.norm(np.diff(closed, axis=0), axis=1)))
    places = np.arange(0, length[-1], _STEP)
    points = np.column_stack([np.interp(places, length, column) for column in closed.T])
    along = np.roll(points, -2, axis=0) - np.roll(points, 2, axis=0)
    normal = along[:, ::-1] * [1, -1] / np.maximum(np.linalg.norm(along, axis=1), 1e-9)[:, None]
    logs = np.log(cv2.GaussianBlur(light, (0, 0), _BLUR) + FLOOR)
    sides = [np.stack([map_coordinates(
        logs[..., k], (points + _ACROSS * sign * normal)[:, ::-1].T, order=1, mode="nearest")
        for k in range(3)], axis=1) for sign in (1, -1)]
    across = cv2.blur(sides[0] - sides[1], (1, 5), borderType=cv2.BORDER_REFLECT)
    faint = np.linalg.norm(across, axis=1) < MIN_CONTRAST
    seen = np.ones(len(points), bool) if painted is None else ~within(points, painted)
    return float(faint[seen].mean()) if seen.any() else 1.0


def within(points: PixelPath, mask: Mask) -> np.ndarray:
    """Whether points (N, 2) lie in a mask or beside it."""
    columns, rows = np.rint(points).astype(int).T
    return (cv2.dilate(mask.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0)[rows, columns]


def edge_of(light: LinearLight, cloth: Mask, paper: Mask | None = None) -> Pixels:
    """The closed line half way between the light of the cloth and that of the ground beside it;
    ``paper``: where the ground is another one, if there are two."""
    smooth = cv2.GaussianBlur(light, (0, 0), _BLUR)
    band = max(_BAND * max(cloth.shape) / SIDE, 4.0)
    inner = cv2.distanceTransform(cloth.astype(np.uint8), cv2.DIST_L2, 5)
    outer = cv2.distanceTransform((~cloth).astype(np.uint8), cv2.DIST_L2, 5)
    if inner.max() <= band:
        raise InputError("no drape was found, but lines; use a plain ground")
    near = max(cloth.shape) * _NEARBY
    size = (2 * int(near) + 1,) * 2
    inside, around = ((far > band) & (far < band + near) for far in (inner, outer))
    if paper is None:
        ground = _nearby(smooth, around, size)
    else:
        ground = np.where(paper[..., None], _nearby(smooth, around & paper, size),
                          _nearby(smooth, around & ~paper, size))
    across = _nearby(smooth, inside, size) - ground
    contrast = np.maximum((across**2).sum(axis=2), 1e-9)
    field = ((smooth - ground) * across).sum(axis=2) / contrast - 0.5
    field = np.where(inner > band, np.abs(field) + 1e-3, field)
    field = np.where(outer > band, -np.abs(field) - 1e-3, field)
    lines: Any = contourpy.contour_generator(z=field).lines(0.0)
    return max(lines, key=lambda line: cv2.contourArea(line.astype(np.float32)))[:-1]


def _nearby(light: LinearLight, mask: Mask, size: tuple[int, int]) -> LinearLight:
    """Mean of the light of ``mask`` in a window around each pixel, or of all of it."""
    weight = cv2.blur(mask.astype(np.float32), size)[..., None]
    total = cv2.blur(np.where(mask[..., None], light, np.float32(0)), size)
    mean = light[mask].mean(axis=0) if mask.any() else light.mean(axis=(0, 1))
    return np.where(weight > 1e-3, total / np.maximum(weight, 1e-3), mean)
