"""A drape of which every vertex is known: the simplest capture, to compare searches by."""

import numpy as np

from drapenet.refine.attraction import Springs, spring_stiffness
from drapenet.refine.objective import Linearised
from sim.drape import DrapeResult


class VertexPositions:
    """Distances between vertices and their captured places.

    Value: a mean over the specimen of squared distances, each in units of ``sigma``, times half
    the number of vertices.

    Args:
        target: (V, 3) m, on the same mesh.
        weight: (V,) such as the area around each vertex; equal unless given.
        sigma: m, standard deviation of a coordinate.
    """

    nuisances = ()
    start = scale = deviation = np.zeros(0)

    def __init__(
        self, target: np.ndarray, *, weight: np.ndarray | None = None, sigma: float = 1e-3
    ) -> None:
        self._target = target
        weight = np.ones(len(target)) if weight is None else weight
        self._factor = np.repeat(np.sqrt(weight / weight.mean()) / sigma, 3)

    def residuals(self, positions: np.ndarray, nuisance: np.ndarray) -> np.ndarray:
        """Residuals (3 V,)."""
        return self._factor * (positions - self._target).ravel()

    def linearised(self, positions: np.ndarray, nuisance: np.ndarray) -> Linearised:
        """The same with derivatives."""
        residuals = self.residuals(positions, nuisance)

        def along(moves: np.ndarray) -> np.ndarray:
            return self._factor[:, None] * moves.reshape(len(moves), -1).T

        return Linearised(residuals, along, np.zeros((len(residuals), 0)))


def springs_to_vertices(shape: DrapeResult, *, pull: float) -> Springs:
    """Springs that hold the vertices of cloth to those of a registered ``shape``."""
    scene = shape.scene
    free = np.repeat(np.flatnonzero(~scene.held), 3)
    axes = np.tile(np.eye(3), (len(free) // 3, 1))
    return Springs(free, shape.positions[free], axes, spring_stiffness(scene, free, pull))
