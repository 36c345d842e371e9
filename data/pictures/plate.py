"""The plate without cloth in a picture from above."""

import numpy as np

from common.errors import InputError
from data.pictures.cloth import pieces
from data.pictures.edge import edge_of, smoothed
from data.pictures.reading import Photograph

MAX_OUT_OF_ROUND = 0.02  # of the radius, root mean square
MIN_RADIUS = 0.05  # of the picture's smaller side


def find_plate(photograph: Photograph) -> tuple[np.ndarray, float]:
    """Centre (2,) and radius of the largest disc, in pixels of the picture; InputError if it shows
    none that differs from the ground."""
    best, least = None, np.inf
    smooth = smoothed(photograph.light)
    for piece in pieces(photograph):
        try:
            line = edge_of(smooth, piece)
        except InputError:
            continue
        centre, radius = _circle(line)
        off = float(np.sqrt(np.mean((np.hypot(*(line - centre).T) / radius - 1) ** 2)))
        least = min(least, off)
        smallest = MIN_RADIUS * min(photograph.light.shape[:2])
        if off < MAX_OUT_OF_ROUND and radius > max(smallest, best[1] if best else 0.0):
            best = centre, radius
    if best is None:
        seen = f"the roundest thing is {least:.0%} out of round" if least < 1 else "none is seen"
        raise InputError(f"no plate was found ({seen}, at most {MAX_OUT_OF_ROUND:.0%} is a plate): "
                         "show the whole plate from straight above, on a ground of another colour, "
                         "or state plate_px")
    return best


def _circle(line: np.ndarray) -> tuple[np.ndarray, float]:
    """Centre (2,) and radius of the circle nearest to points (N, 2) (least squares)."""
    design = np.column_stack([2 * line, np.ones(len(line))])
    x, y, rest = np.linalg.lstsq(design, (line**2).sum(axis=1), rcond=None)[0]
    return np.array([x, y]), float(np.sqrt(rest + x * x + y * y))
