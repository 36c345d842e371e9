"""Figures of the last points at which an energy was asked for anything."""

from collections.abc import Callable
from typing import TypeVar

import numpy as np

T = TypeVar("T")
_KEPT = 2  # the point a step begins at, and the one that is tried


class Remembered:
    """What a function gave at the last points; it must give nothing that is changed later.

    Newton's method tries a point, takes it, and asks for its gradient and its Hessian. What all
    these need, such as angles, is found once.
    """

    def __init__(self) -> None:
        self._kept: list[tuple[np.ndarray, object]] = []

    def at(self, q: np.ndarray, function: Callable[[np.ndarray], T]) -> T:
        """``function(q)``, remembered or found now; always the same function."""
        for point, value in self._kept:
            if np.array_equal(point, q):
                return value
        value = function(q)
        self._kept = [(q.copy(), value), *self._kept[: _KEPT - 1]]
        return value
