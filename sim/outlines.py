"""Outlines of drapes seen from above: areas, folds, the depth of the hem."""

import numpy as np

from common.types import Outline
from sim.rig import Rig

_MIN_FOLD_DEPTH = 3e-3  # m
_DEPTH_SHARE = 0.88
"""Depth of a hem over that of a straight line of cloth from the plate: simulated discs of 240, 300
and 360 mm and squares of 300 mm, seen from 1 m and 1.2 m, have 0.85 to 0.95, and drape
coefficients corrected with this value are wrong by 0.4 to 0.8 points rms, uncorrected by 4 to 8."""


def coefficient_of_area(area: float, rig: Rig) -> float:
    """Drape coefficient of a projected area, m²."""
    plate = np.pi * rig.plate_radius**2
    return (area - plate) / (rig.specimen_area - plate)


def folds_around(radius: np.ndarray, sigma: float) -> np.ndarray:
    """Indices (n,) of the folds among distances from the axis around a drape, (N,) m, smoothed with
    a standard deviation of ``sigma`` samples: peaks at least 3 mm high, ascending."""
    from scipy.ndimage import gaussian_filter1d

    smooth = gaussian_filter1d(radius, sigma, mode="wrap")
    seam = int(smooth.argmin())  # a minimum is not a peak
    smooth = np.roll(smooth, -seam)
    return np.sort((_peaks(np.append(smooth, smooth[0]), _MIN_FOLD_DEPTH) + seam) % len(radius))


def _peaks(values: np.ndarray, prominence: float) -> np.ndarray:
    """Indices (n,) of the peaks of values (N,) with a ``prominence`` or more: the height above the
    higher of the lowest points between it and a higher value, or the end, on both sides. Those of
    ``scipy.signal``, whose import takes as long as the rest of an estimate."""
    tops = np.flatnonzero((values[1:-1] > values[:-2]) & (values[1:-1] >= values[2:])) + 1
    kept = []
    for top in tops:
        higher = np.flatnonzero(values > values[top])
        start = max(higher[higher < top], default=0)
        end = min(higher[higher > top], default=len(values) - 1)
        base = max(values[start : top + 1].min(), values[top : end + 1].min())
        if values[top] - base >= prominence:
            kept.append(top)
    return np.array(kept, int)


def closed(curve: Outline) -> np.ndarray:
    """Segments (N, 2, 2) of a closed curve (N, 2), as :func:`farthest` takes them."""
    return np.stack([curve, np.roll(curve, -1, axis=0)], axis=1)


def farthest(segments: np.ndarray, points: int) -> np.ndarray:
    """Largest distance (points,) from the origin of segments (N, 2, 2) along azimuths."""
    step = 2 * np.pi / points
    rounding = 1e-9  # an end may lie on an azimuth
    (ax, ay), (bx, by) = (segments[:, k].T.astype(float) for k in (0, 1))
    turn = np.arctan2(ax * by - ay * bx, ax * bx + ay * by)
    begin = np.where(turn >= 0, np.arctan2(ay, ax), np.arctan2(by, bx)) / step
    first = np.ceil(begin - rounding).astype(int)
    count = np.floor(begin + np.abs(turn) / step + rounding).astype(int) + 1 - first
    count = np.where(np.isfinite(turn), np.maximum(count, 0), 0)
    row = np.repeat(np.arange(len(segments)), count)
    azimuth = first[row] + np.arange(len(row)) - np.repeat(np.cumsum(count) - count, count)
    azimuth %= points
    wide, high = (bx - ax)[row], (by - ay)[row]
    across = np.cos(step * azimuth) * high - np.sin(step * azimuth) * wide
    level = across != 0.0
    row, azimuth = row[level], azimuth[level]
    radius = np.zeros(points)
    np.maximum.at(radius, azimuth, (ax[row] * high[level] - ay[row] * wide[level]) / across[level])
    return radius


def hem_depth(radius: np.ndarray, flat: np.ndarray, rig: Rig) -> np.ndarray:
    """Depths (...,), m, of a hem below the plate at distances ``radius`` (...,), m, from the axis,
    where the flat specimen reaches to ``flat`` (...,), m: cloth does not stretch."""
    out = np.maximum(radius - rig.plate_radius, 0)
    return _DEPTH_SHARE * np.sqrt(
        np.maximum(np.square(flat - rig.plate_radius) - np.square(out), 0))
