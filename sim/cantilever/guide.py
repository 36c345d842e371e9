"""A guide that keeps a strip's rulings level across it, as in an infinitely wide sheet."""

import numpy as np

from sim.energies.base import Energy
from sim.mesh import Mesh


class GuidedSides(Energy):
    """Penalty on whatever is not a cylinder across the strip.

    A strip cut off the yarn directions twists when it bends, and one with a Poisson effect
    curves across. Held to a cylinder it carries the law's torque for the cut's direction. The
    guide ties each vertex to its neighbour across the strip, along x and z, and stops the cloth
    at the sides from turning about them.

    Args:
        mesh: a strip's grid, vertices numbered column by column.
        across: vertices in a column.
        stiffness: N/m of each tie; N·m for the sides after multiplication by ``edge`` squared.
        edge: spacing of the mesh, m.
    """

    def __init__(self, mesh: Mesh, *, across: int, stiffness: float, edge: float) -> None:
        vertices = len(mesh.rest)
        grid = np.arange(vertices).reshape(-1, across)
        a, b = grid[:, :-1].ravel(), grid[:, 1:].ravel()
        ties = np.concatenate([np.stack([3 * a + k, 3 * b + k], axis=1) for k in (0, 2)])
        row = mesh.edges % across
        border = (mesh.edge_faces[:, 1] < 0) & (row[:, 0] == row[:, 1])
        sides = 3 * vertices + np.flatnonzero(border)
        stops = np.stack([sides, np.full(len(sides), -1)], axis=1)
        self.dofs = np.concatenate([ties, stops])
        self._signs = np.where(self.dofs >= 0, [1.0, -1.0], 0.0)
        self._stiffness = np.repeat([stiffness, stiffness * edge**2], [len(ties), len(stops)])

    def _differences(self, q: np.ndarray) -> np.ndarray:
        return (self._signs * q[self.dofs]).sum(axis=1)

    def value(self, q: np.ndarray) -> float:
        return float(0.5 * self._stiffness @ self._differences(q) ** 2)

    def gradient(self, q: np.ndarray) -> np.ndarray:
        return (self._stiffness * self._differences(q))[:, None] * self._signs

    def hessian(self, q: np.ndarray, convex: bool = False) -> np.ndarray:
        return self._stiffness[:, None, None] * self._signs[:, :, None] * self._signs[:, None, :]
