"""What an energy needs at a state more than once, such as angles, found once."""

from collections.abc import Callable
from typing import TypeVar

import numpy as np

T = TypeVar("T")


class StateCache:
    """What one function gave at the latest states.

    Newton's method tries a state, takes it, and asks for its gradient and its Hessian.

    Args:
        states: how many; two are the one a step begins at, and the one that is tried.
    """

    def __init__(self, states: int = 2) -> None:
        self._states = states
        self._latest: list[tuple[np.ndarray, object]] = []

    def at(self, q: np.ndarray, function: Callable[[np.ndarray], T]) -> T:
        """``function(q)``, kept or found now; always the same function."""
        for state, value in self._latest:
            if np.array_equal(state, q):
                return value
        value = function(q)
        self._latest = [(q.copy(), value), *self._latest[: self._states - 1]]
        return value
