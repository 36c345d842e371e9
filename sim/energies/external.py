"""External forces: the weight of the cloth, and contact with the solid under the plate."""

import numba
import numpy as np

from common.types import Density, StateVector
from sim.energies.base import Energy, FusedEnergy, add_elements
from sim.mesh import Mesh
from sim.rig import Cylinder
from sim.solver.linear import add_blocks


class Gravity(Energy):
    """Potential energy of the vertices, sum of m g z, ``gravity`` g in m/s²; one element each. The
    ``areas`` (V,), m², are those of the mesh, unless others are given."""

    def __init__(
        self, mesh: Mesh, *, density: Density, gravity: float, areas: np.ndarray | None = None
    ) -> None:
        areas = mesh.vertex_areas if areas is None else areas
        self.weights = density * gravity * areas  # (V,) N
        self.dofs = 3 * np.arange(len(mesh.rest))[:, None] + 2

    def value(self, q: StateVector) -> float:
        return float(self.weights @ q[self.dofs[:, 0]])

    def gradient(self, q: StateVector) -> np.ndarray:
        return self.weights[:, None]

    def hessian(self, q: StateVector, convex: bool = False) -> None:
        return None


DEPTH = 0.002
"""Depth, relative to the radius of the plate, at which an obstacle exerts its nominal pressure."""


class ObstacleContact(FusedEnergy):
    """Penalty A p d³/(3 s²) on the depth d of points of the cloth in an obstacle.

    The pressure p at depth s supports the cloth; the cubic keeps the Hessian continuous at first
    contact. Each point is the mean of its ``vertices`` (N, k): one, or the two ends of an edge.
    Areas (N,) are in m², the pressure p in N/m².
    """

    def __init__(
        self, vertices: np.ndarray, areas: np.ndarray, *, obstacle: Cylinder, pressure: float
    ) -> None:
        self.dofs = (3 * vertices[:, :, None] + np.arange(3)).reshape(len(vertices), -1)
        self._ends = vertices.shape[1]  # k
        self._scale = areas * pressure / (DEPTH * obstacle.radius) ** 2  # (N,) N/m²
        self._obstacle = obstacle

    def _add_forces(self, q: StateVector, targets: np.ndarray, forces: np.ndarray) -> float:
        touching, points, depth = self._find_contacts(q)
        push = -(1.0 / self._ends) * self._scale[touching] * depth**2
        force = push[:, None] * self._obstacle.normals(points)
        add_elements(forces, targets[touching], np.tile(force, self._ends))
        return float(self._scale[touching] @ depth**3) / 3

    def add_stiffness(
        self, q: StateVector, slots: np.ndarray, exact: np.ndarray, convex: np.ndarray
    ) -> None:
        touching, points, depth = self._find_contacts(q)
        normal = self._obstacle.normals(points)
        scale = (self._scale[touching] * depth / self._ends**2)[:, None, None]
        block = 2.0 * scale * normal[:, :, None] * normal[:, None, :]
        if len(convex):
            self._add_blocks(convex, slots[touching], block)
        if len(exact):
            # Curvature of the surface: the direction of the force changes along it.
            block += scale * depth[:, None, None] * self._obstacle.depth_hessians(points)
            self._add_blocks(exact, slots[touching], block)

    def _add_blocks(self, data: np.ndarray, slots: np.ndarray, block: np.ndarray) -> None:
        """Add the ``block`` (M, 3, 3) of each element to all pairs of its one or two vertices."""
        add_blocks(data, slots, np.tile(block, (1, self._ends, self._ends)))

    def _find_contacts(self, q: StateVector) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Indices (M,) of the elements in contact, their points (M, 3) and depths (M,)."""
        points = _means(q, self.dofs)
        depth = self._obstacle.depths(points)
        touching = np.flatnonzero(depth > 0.0)
        return touching, points[touching], depth[touching]


@numba.njit(cache=True)
def _means(q, dofs):
    """Means (N, 3) of the vertices of each element."""
    points, share = np.zeros((len(dofs), 3)), 3.0 / dofs.shape[1]
    for t in range(len(dofs)):
        for k in range(dofs.shape[1]):
            points[t, k % 3] += share * q[dofs[t, k]]
    return points
