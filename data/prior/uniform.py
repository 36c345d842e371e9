"""A box of fabrics, all equally likely: what sampling without a prior means."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np


@dataclass(frozen=True)
class UniformPrior:
    """A uniform distribution of theta within limits, to compare priors with.

    Attributes:
        low, high: (6,) limits of theta.
    """

    low: np.ndarray
    high: np.ndarray
    kind: ClassVar[str] = "uniform"
    fabrics: ClassVar[int] = 0

    @classmethod
    def around(cls, theta: np.ndarray, *, tail: float = 0.01) -> "UniformPrior":
        """Between the quantiles ``tail`` and 1 - ``tail`` of each entry of theta (F, 6)."""
        return cls(*np.quantile(theta, [tail, 1 - tail], axis=0))

    def sample(self, n: int, rng: np.random.Generator) -> np.ndarray:
        """Draw theta (n, 6), admissible or not."""
        return rng.uniform(self.low, self.high, (n, 6))

    def as_dict(self) -> dict:
        """All parameters, in JSON's types."""
        return {"low": self.low.tolist(), "high": self.high.tolist()}
