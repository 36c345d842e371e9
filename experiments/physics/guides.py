"""Constraints that make a strip bend as a cylinder, like an infinitely wide one.

A strip cut at an angle to the yarns twists when it bends, and one with a Poisson effect curves
across. Constrained to a cylinder it has the torque of the law in its direction. Strips are grids
whose columns of ``across`` + 1 vertices are numbered consecutively.
"""

from dataclasses import replace
from functools import partial

import numpy as np

from sim.cloth import Laws
from sim.energies.base import Energy
from sim.material import Fabric
from sim.mesh import Mesh

TIE_STIFFNESS = 100.0
"""Stiffness of the ties in units of alpha/edge²; the rulings are level within 1e-4."""


def guided(laws: Laws, across: int) -> Laws:
    """Add the constraint to a cylinder to ``laws``, for a strip with ``across`` mesh cells."""
    ties = (partial(TiedRows, across=across), partial(LevelSides, across=across))
    return replace(laws, others=(*laws.others, *ties))


class TiedRows(Energy):
    """Penalty on differences in x and z between neighbours across a strip."""

    def __init__(self, mesh: Mesh, active: np.ndarray, *, fabric: Fabric, across: int) -> None:
        grid = np.arange(len(mesh.rest)).reshape(-1, across + 1)
        edge = float(np.linalg.norm(mesh.rest[across + 1] - mesh.rest[0]))
        neighbours = np.stack([grid[:, :-1], grid[:, 1:]], axis=-1).reshape(-1, 2)
        self.dofs = np.concatenate([3 * neighbours, 3 * neighbours + 2])
        self._stiffness = TIE_STIFFNESS * float(fabric.alpha.max()) / edge**2  # N/m of each tie

    def value(self, q: np.ndarray) -> float:
        return 0.5 * self._stiffness * float((self._differences(q) ** 2).sum())

    def gradient(self, q: np.ndarray) -> np.ndarray:
        return self._stiffness * self._differences(q)[:, None] * [1.0, -1.0]

    def hessian(self, q: np.ndarray, convex: bool = False) -> np.ndarray:
        block = self._stiffness * np.array([[1.0, -1.0], [-1.0, 1.0]])
        return np.broadcast_to(block, (len(self.dofs), 2, 2))

    def _differences(self, q: np.ndarray) -> np.ndarray:
        return q[self.dofs[:, 0]] - q[self.dofs[:, 1]]


class LevelSides(Energy):
    """Penalty on the component across the strip, y, of the normals at its sides.

    The Hessian omits the terms proportional to this component.
    """

    def __init__(self, mesh: Mesh, active: np.ndarray, *, fabric: Fabric, across: int) -> None:
        row = mesh.edges % (across + 1)
        sides = np.flatnonzero((mesh.edge_faces[:, 1] < 0) & (row[:, 0] == row[:, 1]))
        ends = (3 * mesh.edges[sides][:, :, None] + np.arange(3)).reshape(-1, 6)
        coordinates = 3 * len(mesh.rest)
        self.dofs = np.concatenate([ends, coordinates + sides[:, None]], axis=1)
        self._normals = coordinates + 3 * sides[:, None] + np.arange(3)
        self._stiffness = TIE_STIFFNESS * float(fabric.alpha.max())  # N·m per side edge

    def value(self, q: np.ndarray) -> float:
        return 0.5 * self._stiffness * float((q[self._normals[:, 1]] ** 2).sum())

    def gradient(self, q: np.ndarray) -> np.ndarray:
        return self._stiffness * q[self._normals[:, 1]][:, None] * self._rows(q)

    def hessian(self, q: np.ndarray, convex: bool = False) -> np.ndarray:
        rows = self._rows(q)
        return self._stiffness * rows[:, :, None] * rows[:, None, :]

    def _rows(self, q: np.ndarray) -> np.ndarray:
        """Derivatives (N, 7) of the normals' components by both end points and the rotation."""
        normal, edge = q[self._normals], q[self.dofs[:, 3:6]] - q[self.dofs[:, :3]]
        length = np.linalg.norm(edge, axis=1, keepdims=True)
        along = edge / length
        tilt = along[:, 1:2] * normal / length
        turn = along[:, 2] * normal[:, 0] - along[:, 0] * normal[:, 2]
        return np.concatenate([tilt, -tilt, turn[:, None]], axis=1)
