"""Geometry of vectors."""

import numpy as np


def angle_between(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Angle (...), rad, between vectors (..., D) of any length but 0.

    The arc cosine of their product is inaccurate where they are nearly parallel, and has no value
    where the product rounds to more than 1, which depends on the processor.
    """
    one, other = (np.asarray(v) / np.linalg.norm(v, axis=-1, keepdims=True) for v in (one, other))
    return 2 * np.arctan2(np.linalg.norm(one - other, axis=-1),
                          np.linalg.norm(one + other, axis=-1))
