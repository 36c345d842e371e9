"""Errors with which outlines are read from photographs, drawn at random for training: those of
rendered pictures over the mat (``python -m data.dataset.reading``), and faults in silence."""

from functools import cache
from pathlib import Path

import numpy as np

from drapenet.views.directions import AZIMUTH, AZIMUTHS

BUNDLED = Path(__file__).resolve().parents[2] / "data" / "weights" / "reading.npz"
_TIMES = (0.3, 1.3)  # of the errors of the file, least and most
_FAULTY = 0.3  # share of outlines with a bite or a bulge that nothing tells of
_WIDE = np.radians(3.0), np.radians(20.0)  # half its width, least and most
_EDGE = 0.1, 1.0  # share of that in which it rises, least and most
_HIGH = 0.03  # of half a size, its deviation


@cache
def _stored() -> tuple[np.ndarray, np.ndarray]:
    with np.load(BUNDLED, allow_pickle=False) as arrays:
        return arrays["off"].astype(np.float32), arrays["stated"].astype(np.float32)


def reading_errors(count: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Errors (N, AZIMUTHS) of outlines as they are read, in half sizes, and the standard deviations
    that are stated with them."""
    stored = _stored()
    rows, turn = rng.integers(len(stored[0]), size=count), rng.uniform(0, 2 * np.pi, count)
    low, high = np.log(_TIMES)
    way, times = rng.choice([-1, 1], count), np.exp(rng.uniform(low, high, count))
    azimuth = np.arange(stored[0].shape[1]) * (2 * np.pi / stored[0].shape[1])
    off, stated = (np.array([
        size * np.interp(one * AZIMUTH + start, azimuth, values, period=2 * np.pi)
        for values, start, one, size in zip(part[rows], turn, way, times, strict=True)])
        .reshape(count, AZIMUTHS) for part in stored)
    return off, stated


def faults(count: int, rng: np.random.Generator) -> np.ndarray:
    """Errors (N, AZIMUTHS), in half sizes, of bites and bulges, most without any."""
    middle, wide = rng.uniform(0, 2 * np.pi, (count, 1)), rng.uniform(*_WIDE, (count, 1))
    edge = rng.uniform(*_EDGE, (count, 1))
    high = _HIGH * rng.standard_normal((count, 1)) * (rng.random((count, 1)) < _FAULTY)
    away = np.abs((AZIMUTH - middle + np.pi) % (2 * np.pi) - np.pi) / wide
    return high * np.square(np.sin(np.clip((1 - away) / edge, 0, 1) * np.pi / 2))
