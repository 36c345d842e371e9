"""Splitting of a dataset by fabric."""

import hashlib
from bisect import bisect_right
from collections.abc import Mapping

import numpy as np

from common.errors import InputError


def split_by_fabric(fabrics: np.ndarray, *, fractions: Mapping[str, float]) -> np.ndarray:
    """Name of the split of each drape, from the ids ``fabrics`` (N,) of their fabrics.

    A fabric's split depends only on its id: all drapes of a fabric are in the same split, also when
    the dataset is extended.

    Raises:
        InputError: the fractions are negative or do not add up to 1.
    """
    shares = list(fractions.values())
    if min(shares) < 0 or abs(sum(shares) - 1) > 1e-9:
        raise InputError(f"the fractions of the splits must add up to 1, not {sum(shares):g}")
    bounds = np.cumsum(shares)[:-1].tolist()
    names = list(fractions)
    ids, position = np.unique(np.asarray(fabrics), return_inverse=True)
    chosen = [names[bisect_right(bounds, _uniform(f"0:{fabric}"))] for fabric in ids]
    return np.array(chosen)[position]


def _uniform(key: str) -> float:
    """A number in [0, 1) that depends only on ``key``."""
    return int.from_bytes(hashlib.sha256(key.encode()).digest()[:6], "big") / 2**48
