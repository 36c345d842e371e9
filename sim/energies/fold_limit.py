"""Keeps hinges from folding through themselves, where meshes are too coarse for the cloth."""

import numba
import numpy as np

from sim.energies import dihedral
from sim.mesh import Mesh

LIMIT_START = 2.4  # rad; the angle at which the resistance begins
_LEAST_ROOM = 0.2  # share of the way to pi that a step must leave


class FoldLimit:
    """Barrier k e/h (-(|theta| - s)² log((pi - |theta|)/(pi - s))) on hinges folded beyond s.

    theta is the dihedral angle, s = ``LIMIT_START``, e/h the edge's length over the mean height
    of its triangles. The barrier is smooth, zero up to s and infinite at pi, where two triangles
    would lie on each other and the angle would jump by 2 pi. A converged drape that feels it is
    not resolved by its mesh.

    Args:
        mesh: the specimen.
        active: (F,) bool, triangles that can move.
        stiffness: k, N·m.
    """

    def __init__(self, mesh: Mesh, active: np.ndarray, *, stiffness: float) -> None:
        face, side = np.nonzero(active[:, None] & (mesh.neighbours >= 0))
        across = mesh.neighbours[face, side]
        # An edge between two active triangles appears twice; keep the first.
        _, first = np.unique(mesh.face_edges[face, side], return_index=True)
        face, side, across = face[first], side[first], across[first]
        corner = mesh.faces[face]
        take = np.arange(len(face))
        ends = corner[take, (side + 1) % 3], corner[take, (side + 2) % 3]
        hinges = np.stack([*ends, corner[take, side], across], axis=1)
        self.dofs = (3 * hinges[:, :, None] + np.arange(3)).reshape(-1, 12)
        edge = mesh.rest[hinges[:, 1]] - mesh.rest[hinges[:, 0]]
        neighbours = mesh.edge_faces[mesh.face_edges[face, side]]
        area = mesh.areas[neighbours].sum(axis=1)
        self._scale = stiffness * (edge**2).sum(axis=1) / area

    def angles(self, q: np.ndarray) -> np.ndarray:
        """(N,) dihedral angles, rad."""
        return _angles(q, self.dofs)

    def value(self, q: np.ndarray) -> float:
        angle = np.abs(self.angles(q))
        bent = angle > LIMIT_START
        return float(self._scale[bent] @ barrier(angle[bent])[0])

    def gradient(self, q: np.ndarray) -> np.ndarray:
        return _gradient(q, self.dofs, self._scale)

    def hessian(self, q: np.ndarray, convexity: float) -> np.ndarray:
        return _hessian(q, self.dofs, self._scale, convexity)

    def allows(self, old: np.ndarray, new: np.ndarray) -> bool:
        """False when a hinge would jump past pi or take most of its way there in one step.

        The second is the fraction-to-boundary rule of interior-point methods: without it, a
        step can end so close to pi that no later one gets away.
        """
        before, after = self.angles(old), self.angles(new)
        room = np.minimum(np.pi - np.abs(before), np.pi - LIMIT_START)
        enough = np.pi - np.abs(after) >= _LEAST_ROOM * room
        return bool(((np.abs(after - before) < np.pi) & enough).all())


@numba.njit(cache=True)
def barrier(angle):
    """Barrier per unit of scale and its first two derivatives at angles >= LIMIT_START."""
    over = angle - LIMIT_START
    left = np.pi - angle
    logarithm = np.log(left / (np.pi - LIMIT_START))
    return (
        -(over**2) * logarithm,
        over**2 / left - 2.0 * over * logarithm,
        4.0 * over / left + over**2 / left**2 - 2.0 * logarithm,
    )


@numba.njit(inline="always")
def _load(q, dofs, x):
    """Copy the corners of one hinge to x (4, 3)."""
    for k in range(12):
        x[k // 3, k % 3] = q[dofs[k]]


@numba.njit(cache=True)
def _angles(q, dofs):
    x = np.empty((4, 3))
    result = np.empty(len(dofs))
    for t in range(len(dofs)):
        _load(q, dofs[t], x)
        result[t] = dihedral.angle(x)
    return result


@numba.njit(cache=True)
def _gradient(q, dofs, scale):
    angles = _angles(q, dofs)
    result = np.zeros((len(dofs), 12))
    x, g = np.empty((4, 3)), np.empty((4, 3))
    for t in range(len(dofs)):
        if abs(angles[t]) > LIMIT_START:
            _load(q, dofs[t], x)
            dihedral.gradient(x, g)
            _, slope, _ = barrier(abs(angles[t]))
            slope *= scale[t] * np.sign(angles[t])
            for k in range(12):
                result[t, k] = slope * g[k // 3, k % 3]
    return result


@numba.njit(cache=True)
def _hessian(q, dofs, scale, convexity):
    angles = _angles(q, dofs)
    result = np.zeros((len(dofs), 12, 12))
    x, g, h = np.empty((4, 3)), np.empty((4, 3)), np.empty((12, 12))
    foot, derivative = np.empty((3, 3)), np.empty((3, 3, 3))
    for t in range(len(dofs)):
        if abs(angles[t]) > LIMIT_START:
            _load(q, dofs[t], x)
            dihedral.gradient(x, g)
            dihedral.hessian(x, h, foot, derivative)
            _, slope, bend = barrier(abs(angles[t]))
            slope *= scale[t] * np.sign(angles[t]) * (1.0 - convexity)
            bend *= scale[t]
            for a in range(12):
                for b in range(12):
                    result[t, a, b] = slope * h[a, b] + bend * g[a // 3, a % 3] * g[b // 3, b % 3]
    return result
