"""Contact with the cylinder under the plate: penalty energy of the penetration depth."""

from dataclasses import dataclass

import numpy as np

from sim.energies.base import Energy
from sim.energies.cache import StateCache

RIM = 0.01
"""Radius of the rounded rim over that of the plate: 0.5 mm for 100 mm of diameter. At a sharp rim
the nearest surface would jump from top to side; the penetration of cloth is smaller than it."""
DEPTH = 0.002
"""Depth, relative to the radius of the plate, at which an obstacle exerts its nominal pressure."""


@dataclass(frozen=True)
class Cylinder:
    """The solid below the plate: z < 0 within ``radius`` (m) of the axis, unbounded downwards. Its
    rim is rounded (:data:`RIM`), in proportion, so that drapes of any size are similar."""

    radius: float

    @property
    def rim(self) -> float:
        """Radius of the rounded rim, m."""
        return RIM * self.radius

    def depths(self, points: np.ndarray) -> np.ndarray:
        """Depths (N,), m, of points (N, 3) below the nearest surface; negative outside. A concave
        function with Lipschitz constant 1."""
        _, outwards, upwards = self._from_rim(points)
        corner = np.hypot(np.maximum(outwards, 0.0), np.maximum(upwards, 0.0))
        return self.rim - corner - np.minimum(np.maximum(outwards, upwards), 0.0)

    def normals(self, points: np.ndarray) -> np.ndarray:
        """Outward normals (N, 3) of the surface nearest to points (N, 3): the negative gradient of
        the depth."""
        away, _, _, across, along = self._surface(points)
        return np.column_stack([away * across[:, None], along])

    def depth_hessians(self, points: np.ndarray) -> np.ndarray:
        """Second derivatives (N, 3, 3) of the depth at points (N, 3), 1/m; negative
        semi-definite."""
        away, distance, corner, across, along = self._surface(points)
        # Curvature around the axis, and that of the rounded rim.
        around = np.column_stack([-away[:, 1], away[:, 0], np.zeros(len(points))])
        over = np.column_stack([-away * along[:, None], across])
        return -((across / distance)[:, None, None] * around[:, :, None] * around[:, None, :]
                 + (1 / corner)[:, None, None] * over[:, :, None] * over[:, None, :])

    def _from_rim(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Distances (N,) from the axis, and radial and vertical ones from the rim's centre line."""
        x, y, z = points.T
        distance = np.hypot(x, y)
        return distance, distance - (self.radius - self.rim), z + self.rim

    def _surface(self, points: np.ndarray) -> tuple[np.ndarray, ...]:
        """Radial directions (N, 2), distances from the axis and from the rim's centre line where
        the rim is nearest (else infinite), and radial and vertical components of the normals."""
        distance, outwards, upwards = self._from_rim(points)
        distance = np.where(distance > 0, distance, 1.0)
        rounded = (outwards > 0) & (upwards > 0)
        corner = np.where(rounded, np.hypot(outwards, upwards), np.inf)
        sideways = outwards > upwards
        return (points[:, :2] / distance[:, None], distance, corner,
                np.where(rounded, outwards / corner, sideways),
                np.where(rounded, upwards / corner, ~sideways))


class ObstacleContact(Energy):
    """Penalty A p d³/(3 s²) on the depth d of points of the cloth in an obstacle.

    The pressure p at depth s supports the cloth; the cubic keeps the Hessian continuous at first
    contact. Each point is the mean of its vertices: one, or the two ends of an edge.

    Args:
        vertices: (N, k) int64, vertices of each point.
        areas: (N,) area of each point, m².
        obstacle: the solid.
        pressure: p, N/m², at the depth s, a multiple of the cloth's weight per area.
    """

    def __init__(
        self, vertices: np.ndarray, areas: np.ndarray, *, obstacle: Cylinder, pressure: float
    ) -> None:
        self.dofs = (3 * vertices[:, :, None] + np.arange(3)).reshape(len(vertices), -1)
        self._count, self._share = vertices.shape[1], 1.0 / vertices.shape[1]
        self._scale = areas * pressure / (DEPTH * obstacle.radius) ** 2  # (N,) N/m²
        self._obstacle = obstacle
        self._touching = StateCache()

    def value(self, q: np.ndarray) -> float:
        touching, _, depth = self._contacts(q)
        return float(self._scale[touching] @ depth**3) / 3

    def gradient(self, q: np.ndarray) -> np.ndarray:
        touching, points, depth = self._contacts(q)
        normal = self._obstacle.normals(points)
        force = -(self._share * self._scale[touching] * depth**2)[:, None] * normal
        result = np.zeros(self.dofs.shape)
        result[touching] = np.tile(force, self._count)
        return result

    def hessian(self, q: np.ndarray, convex: bool = False) -> np.ndarray:
        touching, points, depth = self._contacts(q)
        normal = self._obstacle.normals(points)
        scale = (self._share**2 * self._scale[touching] * depth)[:, None, None]
        block = 2.0 * scale * normal[:, :, None] * normal[:, None, :]
        if not convex:
            # Curvature of the surface: the direction of the force changes along it.
            block += scale * depth[:, None, None] * self._obstacle.depth_hessians(points)
        result = np.zeros((*self.dofs.shape, self.dofs.shape[1]))
        result[touching] = np.tile(block, (1, self._count, self._count))
        return result

    def _contacts(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return self._touching.at(q, self._find_contacts)

    def _find_contacts(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Indices (M,) of the elements in contact, their points (M, 3) and depths (M,)."""
        corners = q[self.dofs].reshape(len(self.dofs), -1, 3)
        points = self._share * sum(corners[:, k] for k in range(self._count))
        depth = self._obstacle.depths(points)
        touching = np.flatnonzero(depth > 0.0)
        return touching, points[touching], depth[touching]
