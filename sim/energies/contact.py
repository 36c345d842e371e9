"""Contact with the cylinder under the plate: one energy turns depth into pressure."""

from dataclasses import dataclass

import numpy as np

from sim.energies.base import Energy
from sim.energies.cache import StateCache

RIM_RADIUS = 5e-4
"""m, to which the rim of the plate is rounded. On a sharp rim the nearest surface would change from
top to side at a touch; cloth presses in by less than this."""
DEPTH = 1e-4
"""m, at which an obstacle presses with its pressure."""


@dataclass(frozen=True)
class Cylinder:
    """The solid below the plate: z < 0 within ``radius`` (m) of the axis, open downwards. Its rim
    is rounded to :data:`RIM_RADIUS`."""

    radius: float

    def depths(self, points: np.ndarray) -> np.ndarray:
        """(N,) depth of points (N, 3) below the nearest surface, m; negative outside. A concave
        function that changes by at most the distance moved."""
        _, outwards, upwards = self._from_rim(points)
        corner = np.hypot(np.maximum(outwards, 0.0), np.maximum(upwards, 0.0))
        return RIM_RADIUS - corner - np.minimum(np.maximum(outwards, upwards), 0.0)

    def normals(self, points: np.ndarray) -> np.ndarray:
        """(N, 3) outward normals of the surface nearest to points (N, 3), against the slope."""
        away, _, _, across, along = self._surface(points)
        return np.column_stack([away * across[:, None], along])

    def bends(self, points: np.ndarray) -> np.ndarray:
        """(N, 3, 3) second derivatives of the depth, 1/m; negative semi-definite."""
        away, distance, corner, across, along = self._surface(points)
        # Round the axis, with the distance from it; round the rim, where top and side meet.
        around = np.column_stack([-away[:, 1], away[:, 0], np.zeros(len(points))])
        over = np.column_stack([-away * along[:, None], across])
        return -((across / distance)[:, None, None] * around[:, :, None] * around[:, None, :]
                 + (1 / corner)[:, None, None] * over[:, :, None] * over[:, None, :])

    def _from_rim(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Distances from the axis, and from the circle that the rim is rounded about: out, up."""
        x, y, z = points.T
        distance = np.hypot(x, y)
        return distance, distance - (self.radius - RIM_RADIUS), z + RIM_RADIUS

    def _surface(self, points: np.ndarray) -> tuple[np.ndarray, ...]:
        """Directions (N, 2) away from the axis, distances from it and from the rim's circle where
        it is nearest (else infinite), and the normals' parts away from the axis and upwards."""
        distance, outwards, upwards = self._from_rim(points)
        distance = np.where(distance > 0, distance, 1.0)
        rounded = (outwards > 0) & (upwards > 0)
        corner = np.where(rounded, np.hypot(outwards, upwards), np.inf)
        sideways = outwards > upwards
        return (points[:, :2] / distance[:, None], distance, corner,
                np.where(rounded, outwards / corner, sideways),
                np.where(rounded, upwards / corner, ~sideways))


class ObstacleContact(Energy):
    """Penalty A p d³/(3 s²) on the depth d inside an obstacle of some of the cloth's points.

    Pressure p at depth s supports the cloth; the cube keeps the Hessian continuous at first touch.
    Each point is the mean of its vertices: one, or the two ends of an edge.

    Args:
        vertices: (N, k) int64, vertices of each point.
        areas: (N,) area each point stands for, m².
        obstacle: what is not entered.
        pressure: p, N/m², a few times the weight of the cloth per area, at the depth s.
    """

    def __init__(
        self, vertices: np.ndarray, areas: np.ndarray, *, obstacle: Cylinder, pressure: float
    ) -> None:
        self.dofs = (3 * vertices[:, :, None] + np.arange(3)).reshape(len(vertices), -1)
        self._count, self._share = vertices.shape[1], 1.0 / vertices.shape[1]
        self._scale = areas * pressure / DEPTH**2  # (N,) N/m²
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
            # The surface's curvature: cloth that slides along it is pushed in another direction.
            block += scale * depth[:, None, None] * self._obstacle.bends(points)
        result = np.zeros((*self.dofs.shape, self.dofs.shape[1]))
        result[touching] = np.tile(block, (1, self._count, self._count))
        return result

    def _contacts(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return self._touching.at(q, self._find_contacts)

    def _find_contacts(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Elements that touch the obstacle, where they are (M, 3) and how deep (M,)."""
        corners = q[self.dofs].reshape(len(self.dofs), -1, 3)
        points = self._share * sum(corners[:, k] for k in range(self._count))
        depth = self._obstacle.depths(points)
        touching = np.flatnonzero(depth > 0.0)
        return touching, points[touching], depth[touching]
