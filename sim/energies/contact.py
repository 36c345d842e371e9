"""Contact with rigid obstacles, such as the cylinder under the plate.

Obstacles are convex. Each gives, for any points, how deep they lie inside it; one energy turns
depth into pressure.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from sim.energies.base import Energy
from sim.energies.cache import StateCache

RIM_RADIUS = 5e-4
"""m, to which the rim of the plate is rounded. On a sharp rim the nearest surface would change from
top to side at a touch; cloth presses in by less than this."""


class Obstacle(Protocol):
    """A convex solid."""

    def depths(self, points: np.ndarray) -> np.ndarray:
        """(N,) depth of points (N, 3) below the nearest surface, m; negative outside.

        A concave function that changes by at most the distance moved.
        """

    def normals(self, points: np.ndarray) -> np.ndarray:
        """(N, 3) outward normals of the surface nearest to points (N, 3), against the slope."""

    def bends(self, points: np.ndarray) -> np.ndarray:
        """(N, 3, 3) second derivatives of the depth, 1/m; negative semi-definite."""


@dataclass(frozen=True)
class Cylinder:
    """The solid below the plate: z < 0 within ``radius`` (m) of the axis, open downwards.

    Its rim is rounded to ``rim`` (m).
    """

    radius: float
    rim: float = RIM_RADIUS

    def depths(self, points: np.ndarray) -> np.ndarray:
        _, outwards, upwards = self._from_rim(points)
        corner = np.hypot(np.maximum(outwards, 0.0), np.maximum(upwards, 0.0))
        return self.rim - corner - np.minimum(np.maximum(outwards, upwards), 0.0)

    def normals(self, points: np.ndarray) -> np.ndarray:
        distance, across, along = self._profile(points)
        x, y, _ = points.T
        safe = np.where(distance > 0, distance, 1.0)
        return np.stack([x / safe * across, y / safe * across, along], axis=1)

    def bends(self, points: np.ndarray) -> np.ndarray:
        distance, across, along = self._profile(points)
        x, y, _ = points.T
        safe = np.where(distance > 0, distance, 1.0)
        _, outwards, upwards = self._from_rim(points)
        # Round the axis, with the distance from it; round the rim, where top and side meet.
        around = np.stack([-y / safe, x / safe, np.zeros(len(points))], axis=1)
        over = np.stack([-x / safe * along, -y / safe * along, across], axis=1)
        rounded = (outwards > 0) & (upwards > 0)
        on_rim = np.where(rounded, 1 / np.where(rounded, np.hypot(outwards, upwards), 1.0), 0.0)
        return -((across / safe)[:, None, None] * around[:, :, None] * around[:, None, :]
                 + on_rim[:, None, None] * over[:, :, None] * over[:, None, :])

    def _from_rim(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Distances from the axis, and from the circle that the rim is rounded about: out, up."""
        x, y, z = points.T
        distance = np.hypot(x, y)
        return distance, distance - (self.radius - self.rim), z + self.rim

    def _profile(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Distances from the axis, and the normals' parts away from it and upwards."""
        distance, outwards, upwards = self._from_rim(points)
        rounded = (outwards > 0) & (upwards > 0)
        size = np.where(rounded, np.hypot(outwards, upwards), 1.0)
        sideways = outwards > upwards
        return (distance, np.where(rounded, outwards / size, sideways),
                np.where(rounded, upwards / size, ~sideways))


class ObstacleContact(Energy):
    """Penalty A p d³/(3 s²) on the depth d inside an obstacle of some of the cloth's points.

    Pressure p at depth s supports the cloth, so that depths stay of the order of s; the cube
    keeps the Hessian continuous at first touch. Each point is the mean of its vertices: one for
    the vertices themselves, two for the middles of edges.

    Args:
        vertices: (N, k) int64, vertices of each point.
        areas: (N,) area each point stands for, m².
        obstacle: what is not entered.
        pressure: p, N/m², a few times the weight of the cloth per area.
        depth: s, m.

    Attributes:
        scale: (N,) A p/s², N/m².
        share: one over the number of vertices of a point.
    """

    def __init__(
        self, vertices: np.ndarray, areas: np.ndarray, *, obstacle: Obstacle, pressure: float,
        depth: float = 1e-4
    ) -> None:
        self.dofs = (3 * vertices[:, :, None] + np.arange(3)).reshape(len(vertices), -1)
        self.share = 1.0 / vertices.shape[1]
        self.scale = areas * pressure / depth**2
        self.obstacle = obstacle
        self._touching = StateCache()

    def value(self, q: np.ndarray) -> float:
        touching, _, depth = self._contacts(q)
        return float(self.scale[touching] @ depth**3) / 3

    def gradient(self, q: np.ndarray) -> np.ndarray:
        touching, points, depth = self._contacts(q)
        normal = self.obstacle.normals(points)
        force = -(self.share * self.scale[touching] * depth**2)[:, None] * normal
        result = np.zeros(self.dofs.shape)
        result[touching] = np.tile(force, self.dofs.shape[1] // 3)
        return result

    def hessian(self, q: np.ndarray, convex: bool = False) -> np.ndarray:
        touching, points, depth = self._contacts(q)
        normal = self.obstacle.normals(points)
        scale = (self.share**2 * self.scale[touching] * depth)[:, None, None]
        block = 2.0 * scale * normal[:, :, None] * normal[:, None, :]
        if not convex:
            # The surface's curvature: cloth that slides along it is pushed in another direction.
            block += scale * depth[:, None, None] * self.obstacle.bends(points)
        count = self.dofs.shape[1] // 3
        result = np.zeros((*self.dofs.shape, self.dofs.shape[1]))
        result[touching] = np.tile(block, (1, count, count))
        return result

    def _contacts(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Elements that touch the obstacle, where they are (M, 3) and how deep (M,)."""
        return self._touching.at(q, self._find_contacts)

    def _find_contacts(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        corners = q[self.dofs].reshape(len(self.dofs), -1, 3)
        points = self.share * sum(corners[:, k] for k in range(corners.shape[1]))
        depth = self.obstacle.depths(points)
        touching = np.flatnonzero(depth > 0.0)
        return touching, points[touching], depth[touching]
