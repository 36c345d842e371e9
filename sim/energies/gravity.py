"""Weight of the cloth."""

import numpy as np

from sim.energies.base import Energy
from sim.mesh import Mesh


class Gravity(Energy):
    """Potential energy of the vertices, sum of m g z (J); one element per vertex.

    Args:
        mesh: the specimen.
        density: kg/m².
        gravity: m/s², towards -z.
    """

    def __init__(self, mesh: Mesh, *, density: float, gravity: float) -> None:
        self.weights = density * gravity * mesh.vertex_areas  # (V,) N
        self.dofs = 3 * np.arange(len(mesh.rest))[:, None] + 2

    def value(self, q: np.ndarray) -> float:
        return float(self.weights @ q[self.dofs[:, 0]])

    def gradient(self, q: np.ndarray) -> np.ndarray:
        return self.weights[:, None]

    def hessian(self, q: np.ndarray, convex: bool = False) -> None:
        return None
