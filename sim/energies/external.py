"""External forces: the weight of the cloth, and contact with the solid under the plate."""

import numpy as np

from common.types import Density, StateVector
from sim.energies.base import Energy, StateCache
from sim.mesh import Mesh
from sim.rig import Cylinder


class Gravity(Energy):
    """Potential energy of the vertices, sum of m g z, ``gravity`` g in m/s²; one element each."""

    def __init__(self, mesh: Mesh, *, density: Density, gravity: float) -> None:
        self.weights = density * gravity * mesh.vertex_areas  # (V,) N
        self.dofs = 3 * np.arange(len(mesh.rest))[:, None] + 2

    def value(self, q: StateVector) -> float:
        return float(self.weights @ q[self.dofs[:, 0]])

    def gradient(self, q: StateVector) -> np.ndarray:
        return self.weights[:, None]

    def hessian(self, q: StateVector, convex: bool = False) -> None:
        return None


DEPTH = 0.002
"""Depth, relative to the radius of the plate, at which an obstacle exerts its nominal pressure."""


class ObstacleContact(Energy):
    """Penalty A p d³/(3 s²) on the depth d of points of the cloth in an obstacle.

    The pressure p at depth s supports the cloth; the cubic keeps the Hessian continuous at first
    contact. Each point is the mean of its ``vertices`` (N, k): one, or the two ends of an edge.
    Areas (N,) are in m², the pressure p in N/m².
    """

    def __init__(
        self, vertices: np.ndarray, areas: np.ndarray, *, obstacle: Cylinder, pressure: float
    ) -> None:
        self.dofs = (3 * vertices[:, :, None] + np.arange(3)).reshape(len(vertices), -1)
        self._count, self._share = vertices.shape[1], 1.0 / vertices.shape[1]
        self._scale = areas * pressure / (DEPTH * obstacle.radius) ** 2  # (N,) N/m²
        self._obstacle = obstacle
        self._touching = StateCache()

    def value(self, q: StateVector) -> float:
        touching, _, depth = self._touching.at(q, self._find_contacts)
        return float(self._scale[touching] @ depth**3) / 3

    def gradient(self, q: StateVector) -> np.ndarray:
        touching, points, depth = self._touching.at(q, self._find_contacts)
        normal = self._obstacle.normals(points)
        force = -(self._share * self._scale[touching] * depth**2)[:, None] * normal
        result = np.zeros(self.dofs.shape)
        result[touching] = np.tile(force, self._count)
        return result

    def hessian(self, q: StateVector, convex: bool = False) -> np.ndarray:
        touching, points, depth = self._touching.at(q, self._find_contacts)
        normal = self._obstacle.normals(points)
        scale = (self._share**2 * self._scale[touching] * depth)[:, None, None]
        block = 2.0 * scale * normal[:, :, None] * normal[:, None, :]
        if not convex:
            # Curvature of the surface: the direction of the force changes along it.
            block += scale * depth[:, None, None] * self._obstacle.depth_hessians(points)
        result = np.zeros((*self.dofs.shape, self.dofs.shape[1]))
        result[touching] = np.tile(block, (1, self._count, self._count))
        return result

    def _find_contacts(self, q: StateVector) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Indices (M,) of the elements in contact, their points (M, 3) and depths (M,)."""
        corners = q[self.dofs].reshape(len(self.dofs), -1, 3)
        points = self._share * sum(corners[:, k] for k in range(self._count))
        depth = self._obstacle.depths(points)
        touching = np.flatnonzero(depth > 0.0)
        return touching, points[touching], depth[touching]
