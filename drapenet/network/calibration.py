"""Errors of estimates and coverage of their intervals."""

from typing import Any

import numpy as np

LEVELS = (0.50, 0.68, 0.90)
_RESAMPLES = 400  # of the bootstrap


def ranks(draws: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """(N, T) share of draws (S, N, T) below the truth (N, T); uniform if calibrated."""
    return (draws < truth).mean(axis=0)


def covered(places: np.ndarray) -> np.ndarray:
    """(L, T) share of ranks (N, T) inside the central intervals of :data:`LEVELS`."""
    levels = np.array(LEVELS)[:, None, None]
    return (np.abs(places - 0.5) <= levels / 2).mean(axis=1)


def inside(places: np.ndarray) -> dict[str, float]:
    """:func:`covered` of ranks (N, T), over all T, by level, such as "68%"."""
    return {f"{level:.0%}": share for level, share in
            zip(LEVELS, covered(places).mean(axis=1).tolist(), strict=True)}


def rms_with_interval(errors: np.ndarray, fabric: np.ndarray) -> dict[str, Any]:
    """Root mean square of errors (N, 3), and its 95 % bootstrap interval over fabrics (N,)."""
    _, place = np.unique(fabric, return_inverse=True)
    count = np.bincount(place)
    squares = np.bincount(place, np.square(errors).mean(axis=1))
    drawn = np.random.default_rng(0).integers(len(count), size=(_RESAMPLES, len(count)))
    resampled = np.sqrt(squares[drawn].sum(axis=1) / count[drawn].sum(axis=1))
    return {"rmse": float(np.sqrt(squares.sum() / count.sum())),
            "interval_95": np.quantile(resampled, [0.025, 0.975]).tolist()}
