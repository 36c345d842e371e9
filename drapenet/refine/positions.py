"""The objective of a drape that has been registered to a mesh: where its vertices lie."""

import math

import numpy as np

from drapenet.refine.objective import Linearised


class RobustPositions:
    """Objective: distances between vertices and their captured places, far ones counting less.

    Value: that of Huber's function of the distances in units of ``sigma``, half its mean over
    ``vertices`` times ``independent``.

    Args:
        target: (V, 3) m, on the same mesh.
        vertices: (V,) bool, those that count.
        sigma: m, standard deviation of a distance; those of 2 mm already are far.
        limit: in units of ``sigma``, from which the value grows linearly.
        independent: how many of the distances are independent: of one fold, about one.
    """

    nuisances = ()
    start = scale = deviation = np.zeros(0)

    def __init__(
        self, target: np.ndarray, *, vertices: np.ndarray, sigma: float = 2e-3,
        limit: float = 1.0, independent: float = 100.0,
    ) -> None:
        self._target, self._vertices = target, np.flatnonzero(vertices)
        self._sigma, self._limit = sigma, limit
        self._independent = independent
        self._factor = math.sqrt(independent / len(self._vertices))

    def residuals(self, positions: np.ndarray, nuisance: np.ndarray) -> np.ndarray:
        """Residuals (3 N,)."""
        return self._bent(positions)[0].ravel()

    def linearised(self, positions: np.ndarray, nuisance: np.ndarray) -> Linearised:
        """The same with derivatives."""
        residuals, scale, across = self._bent(positions)

        def along(moves: np.ndarray) -> np.ndarray:
            chosen = moves[:, self._vertices]
            inward = (across * chosen).sum(-1, keepdims=True)
            return (scale[:, None] * chosen + residuals * inward).reshape(len(moves), -1).T

        return Linearised(residuals.ravel(), along, np.zeros((residuals.size, 0)),
                          self._independent)

    def _bent(self, positions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Residuals (N, 3), their factor (N,), and its relative derivative by the gap (N, 3)."""
        gap = (positions - self._target)[self._vertices]
        distance = np.maximum(np.linalg.norm(gap, axis=1) / self._sigma, 1e-12)
        far = distance > self._limit
        bent = np.sqrt(np.where(far, 2 * self._limit * distance - self._limit**2, 1.0))
        scale = np.where(far, bent / distance, 1.0) * self._factor / self._sigma
        # d log(bent/d)/dd = limit/bent² - 1/d, along the gap's direction
        slope = np.where(far, self._limit / bent**2 - 1 / distance, 0.0)
        across = (slope / distance)[:, None] * gap / self._sigma**2
        return scale[:, None] * gap, scale, across
