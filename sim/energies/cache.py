"""Cache of quantities that an energy needs repeatedly at the same state, such as angles."""

from collections.abc import Callable
from typing import TypeVar

import numpy as np

T = TypeVar("T")


class StateCache:
    """Results of one function at the latest states.

    Newton's method evaluates a trial state, then its gradient and its Hessian.

    Args:
        states: number of states; two hold the start of a step and the trial state.
    """

    def __init__(self, states: int = 2) -> None:
        self._states = states
        self._latest: list[tuple[np.ndarray, object]] = []

    def at(self, q: np.ndarray, function: Callable[[np.ndarray], T]) -> T:
        """``function(q)``, cached or computed; ``function`` must be the same in all calls."""
        for state, value in self._latest:
            if np.array_equal(state, q):
                return value
        value = function(q)
        self._latest = [(q.copy(), value), *self._latest[: self._states - 1]]
        return value
