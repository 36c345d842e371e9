"""The fabrics of a table themselves, each as likely as any other."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from data.prior.base import check_fabrics


@dataclass(frozen=True)
class TablePrior:
    """Theta of measured fabrics, to judge an estimator on.

    Attributes:
        theta: (F, 6).
    """

    theta: np.ndarray
    kind: ClassVar[str] = "table"

    @property
    def fabrics(self) -> int:
        """F."""
        return len(self.theta)

    @classmethod
    def fit(cls, theta: np.ndarray) -> "TablePrior":
        """Keep theta (F, 6)."""
        return cls(check_fabrics(theta, least=1))

    def sample(self, n: int, rng: np.random.Generator) -> np.ndarray:
        """Draw theta (n, 6), with repetition."""
        return self.theta[rng.integers(len(self.theta), size=n)]

    def as_dict(self) -> dict:
        """All parameters, in JSON's types."""
        return {"theta": self.theta.tolist()}
