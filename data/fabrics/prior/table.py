"""Empirical prior: the fabrics of a table, with equal probability."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from data.fabrics.prior.base import Stored, array


def _wrong(theta: np.ndarray) -> str:
    return "" if len(theta) else "give at least one fabric"


@dataclass(frozen=True)
class TablePrior(Stored):
    """``theta`` (F, 6) of measured fabrics, for the evaluation of estimators."""

    theta: array(None, 6, check=_wrong)
    kind: ClassVar[str] = "table"

    def sample(self, n: int, rng: np.random.Generator) -> np.ndarray:
        """Draw theta (n, 6), with repetition."""
        return self.theta[rng.integers(len(self.theta), size=n)]
