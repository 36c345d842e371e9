"""Contact with the cylinder under the plate."""

import numba
import numpy as np


class CylinderContact:
    """Penalty A p d³/(3 s²) on the depth d of a vertex inside the solid cylinder.

    The solid is z < 0 within the plate's radius, open downwards. The depth is the distance to
    the nearest surface, side or top. Pressure p at depth s supports the cloth, so that depths
    stay of the order of s; the cube keeps the Hessian continuous at first touch.

    Args:
        areas: (V,) area each vertex stands for, m².
        radius: of the cylinder, m.
        pressure: p, N/m², a few times the weight of the cloth per area.
        depth: s, m.
    """

    def __init__(
        self, areas: np.ndarray, *, radius: float, pressure: float, depth: float = 1e-4
    ) -> None:
        self.dofs = np.arange(3 * len(areas)).reshape(-1, 3)
        self._scale = areas * pressure / depth**2
        self._radius = radius

    def value(self, q: np.ndarray) -> float:
        depth, _, _ = self._depth(q)
        return float(self._scale @ depth**3) / 3

    def gradient(self, q: np.ndarray) -> np.ndarray:
        depth, normal, _ = self._depth(q)
        return -(self._scale * depth**2)[:, None] * normal

    def hessian(self, q: np.ndarray, convexity: float) -> np.ndarray:
        depth, normal, radius = self._depth(q)
        return _hessian(depth, normal, radius, self._scale, convexity)

    def allows(self, old: np.ndarray, new: np.ndarray) -> bool:
        return True

    def _depth(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Depth (V,), outward normal (V, 3) and distance from the axis (V,)."""
        x, y, z = q[self.dofs].T
        radius = np.hypot(x, y)
        side, top = self._radius - radius, -z
        inside = (side > 0) & (top > 0)
        sideways = side < top
        depth = np.where(inside, np.minimum(side, top), 0.0)
        safe = np.where(radius > 0, radius, 1.0)
        normal = np.stack([x / safe * sideways, y / safe * sideways, 1.0 - sideways], axis=1)
        return depth, normal, radius


@numba.njit(cache=True)
def _hessian(depth, normal, radius, scale, convexity):
    result = np.zeros((len(depth), 3, 3))
    for a in range(len(depth)):
        if depth[a] <= 0.0:
            continue
        stiffness = 2.0 * scale[a] * depth[a]
        for i in range(3):
            for j in range(3):
                result[a, i, j] = stiffness * normal[a, i] * normal[a, j]
        if normal[a, 2] == 0.0:
            # Curvature of the side: along the tangent, force/radius, pushing outwards.
            bend = -(1.0 - convexity) * scale[a] * depth[a] ** 2 / radius[a]
            tx, ty = -normal[a, 1], normal[a, 0]
            result[a, 0, 0] += bend * tx * tx
            result[a, 0, 1] += bend * tx * ty
            result[a, 1, 0] += bend * tx * ty
            result[a, 1, 1] += bend * ty * ty
    return result
