"""The plate without cloth in a picture from above."""

import cv2
import numpy as np

from common.errors import InputError
from data.pictures.edge import edge_of, smoothed
from data.pictures.reading import Photograph

SIDE = 600  # pixels, of the picture in which circles are looked for (Hough)
RADII = 0.05, 0.5  # of the picture's smaller side
MAX_OUT_OF_ROUND = 0.02  # of the radius, root mean square
_ROUND, _EDGE = 0.7, 60  # least share of a circle's edge, and its strength (OpenCV)
_NEAR = 3.0  # pixels, error of a circle


def find_plate(photograph: Photograph) -> tuple[np.ndarray, float]:
    """Centre (2,) and radius of the largest disc, in pixels of the picture; InputError if it shows
    none that differs from the ground."""
    size = photograph.light.shape[1::-1]
    scale = min(1.0, SIDE / max(size))
    small = cv2.resize(photograph.grey.astype(np.uint8), None, fx=scale, fy=scale,
                       interpolation=cv2.INTER_AREA)
    least, most = (round(share * scale * min(size)) for share in RADII)
    circles = cv2.HoughCircles(cv2.GaussianBlur(small, (0, 0), 1.5), cv2.HOUGH_GRADIENT_ALT, 1.5,
                               least, param1=_EDGE, param2=_ROUND, minRadius=least, maxRadius=most)
    smooth, best, out = smoothed(photograph.light), None, np.inf
    for x, y, radius in [] if circles is None else circles[0]:
        count = int(2 * np.pi * radius / scale)
        turn = np.arange(count) * (2 * np.pi / count)
        border = (np.array([x, y]) + 0.5) / scale - 0.5 + radius / scale * np.column_stack(
            [np.cos(turn), np.sin(turn)])
        line, _ = edge_of(smooth, border, np.full(count, _NEAR / scale), scale=_NEAR / scale)
        centre, radius = _circle(line)
        off = float(np.sqrt(np.mean((np.hypot(*(line - centre).T) / radius - 1) ** 2)))
        out = min(out, off)
        if off < MAX_OUT_OF_ROUND and radius > (best[1] if best else 0.0):
            best = centre, radius
    if best is None:
        seen = f"the roundest thing is {out:.0%} out of round" if out < 1 else "none is seen"
        raise InputError(f"no plate was found ({seen}, at most {MAX_OUT_OF_ROUND:.0%} is a plate): "
                         "show the whole plate from straight above, on a ground of another colour, "
                         "or state plate_px")
    return best


def _circle(line: np.ndarray) -> tuple[np.ndarray, float]:
    """Centre (2,) and radius of the circle nearest to points (N, 2) (least squares)."""
    design = np.column_stack([2 * line, np.ones(len(line))])
    x, y, rest = np.linalg.lstsq(design, (line**2).sum(axis=1), rcond=None)[0]
    return np.array([x, y]), float(np.sqrt(rest + x * x + y * y))
