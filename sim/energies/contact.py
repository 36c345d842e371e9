"""Contact with rigid obstacles: the cylinder under the plate, a tester's ramp.

Obstacles are convex. Each says, for any points, how deep they lie inside it; one energy turns
depth into pressure.
"""

from dataclasses import dataclass
from typing import Protocol

import numba
import numpy as np

from sim.energies.base import Energy
from sim.energies.remember import Remembered


class Obstacle(Protocol):
    """A convex solid."""

    def depths(self, points: np.ndarray) -> np.ndarray:
        """(N,) depth of points (N, 3) below the nearest surface, m; negative outside.

        A concave function that changes by at most the distance moved.
        """

    def normals(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Of the surface nearest to points (N, 3): outward normals (N, 3) and radii (N,), m.

        Radii are those of the surface's curvature about the vertical, infinite where it is flat.
        """


@dataclass(frozen=True)
class Cylinder:
    """The solid below the plate: z < 0 within ``radius`` (m) of the axis, open downwards."""

    radius: float

    def depths(self, points: np.ndarray) -> np.ndarray:
        x, y, z = points.T
        return np.minimum(self.radius - np.hypot(x, y), -z)

    def normals(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        x, y, z = points.T
        distance = np.hypot(x, y)
        sideways = self.radius - distance < -z
        safe = np.where(distance > 0, distance, 1.0)
        normal = np.stack([x / safe * sideways, y / safe * sideways, 1.0 - sideways], axis=1)
        return normal, np.where(sideways, safe, np.inf)


@dataclass(frozen=True)
class Ramp:
    """A platform z = 0 that ends at x = 0 in a plane ``angle`` (rad) below the horizontal.

    The stand of a bending-length tester with a fixed angle.
    """

    angle: float

    def depths(self, points: np.ndarray) -> np.ndarray:
        x, _, z = points.T
        return np.minimum(-z, -(x * np.sin(self.angle) + z * np.cos(self.angle)))

    def normals(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        x, _, z = points.T
        sloping = -(x * np.sin(self.angle) + z * np.cos(self.angle)) < -z
        slope = np.array([np.sin(self.angle), 0.0, np.cos(self.angle)])
        normal = np.where(sloping[:, None], slope, np.array([0.0, 0.0, 1.0]))
        return normal, np.full(len(x), np.inf)


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
        self,
        vertices: np.ndarray,
        areas: np.ndarray,
        *,
        obstacle: Obstacle,
        pressure: float,
        depth: float = 1e-4,
    ) -> None:
        self.dofs = (3 * vertices[:, :, None] + np.arange(3)).reshape(len(vertices), -1)
        self.share = 1.0 / vertices.shape[1]
        self.scale = areas * pressure / depth**2
        self.obstacle = obstacle
        self._touching = Remembered()

    def value(self, q: np.ndarray) -> float:
        touching, _, depth = self._contacts(q)
        return float(self.scale[touching] @ depth**3) / 3

    def gradient(self, q: np.ndarray) -> np.ndarray:
        touching, points, depth = self._contacts(q)
        normal, _ = self.obstacle.normals(points)
        force = -(self.share * self.scale[touching] * depth**2)[:, None] * normal
        result = np.zeros(self.dofs.shape)
        result[touching] = np.tile(force, self.dofs.shape[1] // 3)
        return result

    def hessian(self, q: np.ndarray, convex: bool = False) -> np.ndarray:
        touching, points, depth = self._contacts(q)
        normal, radius = self.obstacle.normals(points)
        scale = self.share**2 * self.scale[touching]
        count = self.dofs.shape[1] // 3
        result = np.zeros((*self.dofs.shape, self.dofs.shape[1]))
        block = _hessian(depth, normal, np.full_like(radius, np.inf) if convex else radius, scale)
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


@numba.njit(cache=True)
def _hessian(depth, normal, radius, scale):
    result = np.zeros((len(depth), 3, 3))
    for a in range(len(depth)):
        stiffness = 2.0 * scale[a] * depth[a]
        for i in range(3):
            for j in range(3):
                result[a, i, j] = stiffness * normal[a, i] * normal[a, j]
        # Curvature of the surface: along its tangent, force/radius, pushing outwards.
        bend = -scale[a] * depth[a] ** 2 / radius[a]
        tx, ty = -normal[a, 1], normal[a, 0]
        result[a, 0, 0] += bend * tx * tx
        result[a, 0, 1] += bend * tx * ty
        result[a, 1, 0] += bend * tx * ty
        result[a, 1, 1] += bend * ty * ty
    return result
