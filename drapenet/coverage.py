"""Do intervals hold as often as they say?"""

import numpy as np

LEVELS = (0.50, 0.68, 0.90)


def ranks(draws: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """(N, T) share of draws (S, N, T) below the truth (N, T): uniform where intervals hold."""
    return (draws < truth).mean(axis=0)


def covered(places: np.ndarray) -> np.ndarray:
    """(L, T) share of ranks (N, T) inside the central intervals of :data:`LEVELS`."""
    levels = np.array(LEVELS)[:, None, None]
    return (np.abs(places - 0.5) <= levels / 2).mean(axis=1)
