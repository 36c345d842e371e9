"""The hinges of a mesh, pairs of triangles that can fold about their common edge.

Which they are, and the derivatives of energies that depend on their dihedral angles alone.
"""

from dataclasses import dataclass

import numba
import numpy as np

from sim.energies import dihedral
from sim.mesh import Mesh


@dataclass(frozen=True)
class HingeStencils:
    """N hinges with at least one triangle that can move, in the order of their edges.

    Attributes:
        edge: (N,) the mesh's edges they fold about.
        corners: (N, 4) vertices in the order of :mod:`sim.energies.dihedral`: the edge's ends,
            then the corners opposite it. The first triangle can move.
        areas: (N, 2) m², rest areas of the two triangles.
        movable: (N, 2) bool, which of the two triangles can move; column 0 is all true.
        vectors: (N, 2) m, the rest edges from their start.
        opposite: (N, 2, 2) m, the two corners opposite the edge, from its start.
    """

    edge: np.ndarray
    corners: np.ndarray
    areas: np.ndarray
    movable: np.ndarray
    vectors: np.ndarray
    opposite: np.ndarray

    @property
    def dofs(self) -> np.ndarray:
        """(N, 12) entries of the unknowns, as :class:`sim.energies.base.Energy` asks for."""
        return (3 * self.corners[:, :, None] + np.arange(3)).reshape(-1, 12)

    @property
    def lengths(self) -> np.ndarray:
        """(N,) m, rest lengths of the edges."""
        return np.linalg.norm(self.vectors, axis=1)

    @property
    def normals(self) -> np.ndarray:
        """(N, 2) unit vectors across the rest edges, in material axes."""
        return np.stack([self.vectors[:, 1], -self.vectors[:, 0]], axis=1) / self.lengths[:, None]


def find_hinges(mesh: Mesh, active: np.ndarray) -> HingeStencils:
    """Hinges of ``mesh`` beside the triangles ``active`` (F,) bool."""
    face, side = np.nonzero(active[:, None] & (mesh.neighbours >= 0))
    across = mesh.neighbours[face, side]
    # An edge between two active triangles appears twice; keep the first.
    edge, first = np.unique(mesh.face_edges[face, side], return_index=True)
    face, side, across = face[first], side[first], across[first]
    corner = mesh.faces[face]
    take = np.arange(len(face))
    start, end = corner[take, (side + 1) % 3], corner[take, (side + 2) % 3]
    corners = np.stack([start, end, corner[take, side], across], axis=1)
    pair = mesh.edge_faces[edge]
    other = np.where(pair[:, 0] == face, pair[:, 1], pair[:, 0])
    both = np.stack([face, other], axis=1)
    origin = mesh.rest[start]
    return HingeStencils(
        edge=edge,
        corners=corners,
        areas=mesh.areas[both],
        movable=active[both],
        vectors=mesh.rest[end] - origin,
        opposite=mesh.rest[corners[:, 2:]] - origin[:, None],
    )


@numba.njit(cache=True)
def hinge_angles(q, dofs):
    """(N,) dihedral angles, rad, of hinges with unknowns ``dofs`` (N, 12) of ``q``."""
    x = np.empty((4, 3))
    result = np.empty(len(dofs))
    for t in range(len(dofs)):
        _load(q, dofs[t], x)
        result[t] = dihedral.angle(x)
    return result


@numba.njit(cache=True)
def chain_gradient(q, dofs, slope):
    """(N, 12) gradients of energies E(theta) with the derivatives ``slope`` (N,), J/rad."""
    result = np.zeros((len(dofs), 12))
    x, g = np.empty((4, 3)), np.empty((4, 3))
    for t in range(len(dofs)):
        if slope[t] != 0.0:
            _load(q, dofs[t], x)
            dihedral.gradient(x, g)
            for k in range(12):
                result[t, k] = slope[t] * g[k // 3, k % 3]
    return result


@numba.njit(cache=True)
def chain_hessian(q, dofs, slope, bend):
    """(N, 12, 12) Hessians of energies E(theta) with derivatives ``slope`` and ``bend`` (N,).

    The part of ``slope`` is indefinite, that of ``bend`` has the sign of ``bend``.
    """
    result = np.zeros((len(dofs), 12, 12))
    x, g, frame = np.empty((4, 3)), np.empty((4, 3)), np.empty((3, 3))
    for t in range(len(dofs)):
        if slope[t] == 0.0 and bend[t] == 0.0:
            continue
        _load(q, dofs[t], x)
        dihedral.gradient(x, g)
        for a in range(12):
            for b in range(12):
                result[t, a, b] = bend[t] * g[a // 3, a % 3] * g[b // 3, b % 3]
        if slope[t] != 0.0:
            dihedral.add_hessian(x, slope[t], (0, 3, 6, 9), frame, result[t])
    return result


@numba.njit(inline="always")
def _load(q, dofs, x):
    """Copy the corners of one hinge to x (4, 3)."""
    for k in range(12):
        x[k // 3, k % 3] = q[dofs[k]]
