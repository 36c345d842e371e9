"""A registered scan as the objective of a refinement: distances of vertices from their places."""

import math
from dataclasses import dataclass

import numpy as np

from common.types import Metres, Points, VertexMask
from drapenet.refine.objective import Linearised, Moves, Nuisance, Residuals, huber
from drapenet.surface.shape import CapturedShape, Cloud, distances
from sim.draping import Drape
from sim.measures import drape_coefficient


@dataclass(frozen=True)
class Fidelity:
    """Comparison of a released drape with its captured shape (Feng et al. 2022, section 7.2)."""

    displacement_mm: float  # mean of hanging vertices from their captured positions
    surface_mm: float  # mean of hanging vertices from the captured surface
    coefficient: float  # drape coefficient, percent
    captured_coefficient: float


def fidelity(shape: CapturedShape, drape: Drape) -> Fidelity:
    """Compare ``drape``, released from ``shape`` on the same mesh, with it."""
    hanging, settled = shape.hanging, drape.positions
    surface = Cloud.of_mesh(shape.positions, shape.faces)
    return Fidelity(
        1e3 * float(np.linalg.norm(settled - shape.positions, axis=1)[hanging].mean()),
        1e3 * float(distances(surface, settled[hanging]).mean()),
        *(100 * drape_coefficient(x, shape.faces, shape.rig) for x in (settled, shape.positions)))


class RobustPositions:
    """Objective: robust distances between vertices and their captured positions.

    Its value is half the mean of Huber's function, linear beyond ``limit``, of the distances of
    ``vertices`` (V,) in units of ``sigma``, times the number of ``independent`` ones.
    """

    nuisances: tuple[str, ...] = ()
    start = scale = deviation = np.zeros(0)

    def __init__(
        self, target: Points, *, vertices: VertexMask, sigma: Metres = 2e-3, limit: float = 1.0,
        independent: float = 100.0,
    ) -> None:
        self._target, self._vertices = target, np.flatnonzero(vertices)
        self._sigma, self._limit = sigma, limit
        self._independent = independent
        self._factor = math.sqrt(independent / len(self._vertices))

    def residuals(self, positions: Points, nuisance: Nuisance) -> Residuals:
        """Three residuals for each vertex."""
        return self._bent(positions)[0].ravel()

    def linearised(self, positions: Points, nuisance: Nuisance) -> Linearised:
        residuals, scale, across = self._bent(positions)

        def along(moves: Moves) -> np.ndarray:
            chosen = moves[:, self._vertices]
            inward = (across * chosen).sum(-1, keepdims=True)
            return (scale[:, None] * chosen + residuals * inward).reshape(len(moves), -1).T

        return Linearised(residuals.ravel(), along, np.zeros((residuals.size, 0)),
                          self._independent)

    def _bent(self, positions: Points) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Residuals (N, 3), their factor (N,), and its relative derivative by the gap (N, 3)."""
        gap = (positions - self._target)[self._vertices]
        distance = np.maximum(np.linalg.norm(gap, axis=1) / self._sigma, 1e-12)
        bent, slope = huber(distance, self._limit)
        scale = bent / distance * self._factor / self._sigma
        # d log(bent/d)/dd, along the gap's direction
        across = ((slope / bent - 1 / distance) / distance)[:, None] * gap / self._sigma**2
        return scale[:, None] * gap, scale, across
