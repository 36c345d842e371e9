"""The state of a cloth: vertex positions and edge normals, and its update by a step.

An edge normal is perpendicular to its edge, so that an unknown of the simulator is a coordinate of
a vertex or the rotation of an edge normal, right-handed about the edge from its first to its second
vertex. Such a rotation has no absolute zero: a step moves every normal by parallel transport from
the old direction of its edge to the new one, the smallest rotation between them, and rotates it by
the step's angle (Grinspun et al. 2006; Bergou et al. 2010).
"""

from dataclasses import dataclass

import numba
import numpy as np

from common.types import FaceMask, Points, StateVector
from sim.mesh import Mesh


@dataclass(eq=False)
class State:
    """State of a cloth."""

    positions: Points
    normals: np.ndarray  # (E, 3) unit normals, in the order of ``mesh.edges``

    @property
    def q(self) -> StateVector:
        """The argument of the energies."""
        return np.concatenate([self.positions.ravel(), self.normals.ravel()])

    @staticmethod
    def of(q: StateVector, vertices: int) -> "State":
        """The state of a cloth with V = ``vertices``."""
        split = q.reshape(-1, 3)
        return State(split[:vertices].copy(), split[vertices:].copy())

    @staticmethod
    def at(mesh: Mesh, positions: Points, active: FaceMask | None = None) -> "State":
        """State with edge normals that bisect the dihedral angles; an edge of a triangle that is
        not active has the normal of that triangle."""
        corners = positions[mesh.faces]
        across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        unit = across / np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-300)
        beside = mesh.edge_faces
        counts = beside >= 0
        if active is not None:
            held = counts & ~active[beside]
            counts &= held | ~held.any(axis=1, keepdims=True)
        first, second = (counts[:, :, None] * unit[beside]).swapaxes(0, 1)
        total = first + second
        size = np.linalg.norm(total, axis=1, keepdims=True)
        # Two triangles folded onto each other have no mean normal.
        flat = size[:, 0] > 1e-9
        normals = np.where(flat[:, None], total / np.where(size > 0, size, 1.0), unit[beside[:, 0]])
        return State(positions=positions.copy(), normals=normals)


@numba.njit(cache=True)
def moved(q, edges, move):
    """``q`` (3 V + 3 E,) after a step ``move`` (3 V + E,): displacements, then rotations."""
    coordinates = len(move) - len(edges)
    result = q.copy()
    for k in range(coordinates):
        result[k] += move[k]
    before, after, turned = np.empty(3), np.empty(3), np.empty(3)
    for e in range(len(edges)):
        a, b = 3 * edges[e, 0], 3 * edges[e, 1]
        angle = move[coordinates + e]
        still = angle == 0.0
        for i in range(3):
            before[i] = q[b + i] - q[a + i]
            after[i] = result[b + i] - result[a + i]
            still = still and before[i] == after[i]
        if still:
            continue
        length = np.sqrt(before @ before)
        new_length = np.sqrt(after @ after)
        scale = cosine_of_edges = 0.0
        at = coordinates + 3 * e
        for i in range(3):
            before[i] /= length
            after[i] /= new_length
            scale += q[at + i] * after[i]
            cosine_of_edges += before[i] * after[i]
        scale /= max(1.0 + cosine_of_edges, 1e-12)
        for i in range(3):
            turned[i] = q[at + i] - scale * (before[i] + after[i])
        cosine, sine = np.cos(angle), np.sin(angle)
        along = square = 0.0
        for i in range(3):
            j, k = (i + 1) % 3, (i + 2) % 3
            result[at + i] = cosine * turned[i] + sine * (
                after[j] * turned[k] - after[k] * turned[j]
            )
            along += result[at + i] * after[i]
        for i in range(3):  # rounding errors must not accumulate over steps
            result[at + i] -= along * after[i]
            square += result[at + i] ** 2
        for i in range(3):
            result[at + i] /= np.sqrt(square)
    return result
