"""Self-contact: a barrier on the distances between triangles and edges of the cloth.

Distances, barrier, derivatives and the collision test of a step are those of the IPC Toolkit (Li et
al. 2020, Incremental Potential Contact; Li et al. 2023, Convergent IPC).
"""

from functools import cache
from types import ModuleType

import numpy as np
from scipy import sparse

from common.types import Faces, Metres, Points, StateVector
from sim.energies.base import FusedEnergy
from sim.material import REFERENCE_DENSITY
from sim.mesh import Mesh
from sim.scene import Scene

_PRESSURE_AT_HALF = 3.0 * np.log(4.0) + 4.5
"""Pressure of two parallel sheets at half the barrier's distance, in units of its stiffness: each
side contributes by its vertices and by its edges, at half the area, with the slope
3/2 log 4 + 9/4. On triangulations that do not match it is 8 % smaller."""

_STEP_MARGIN = 1.25  # a step is allowed if 1.25 times the step is free of collisions


@cache
def import_ipctk() -> ModuleType:
    """The module ipctk, set to one thread."""
    import ipctk  # on demand: inference without simulation does not need it

    ipctk.set_num_threads(1)  # the simulator runs one process per core, one thread each
    return ipctk


class SelfContact(FusedEnergy):
    """Barrier -w k d̂ (s² - 1)² log s², s = d/d̂ < 1, on pairs of primitives at the distance d.

    A pair is a vertex and a triangle, or two edges (with a weight that vanishes where they are
    parallel), without a common vertex; w is its rest area. The barrier is twice continuously
    differentiable, zero for d >= d̂ and infinite at contact; second derivatives of the distance
    jump where the nearest point passes from a triangle to its edge.

    The set of pairs changes during a minimisation, the pattern of the Hessian does not: it couples
    the vertices of all pairs nearer than ``reach`` at ``positions``. A block outside it is replaced
    by an upper bound on the diagonal; the Hessian is exact only where :meth:`is_complete`. An
    element is a vertex or a couple of vertices; only the sum of the convex blocks is semi-definite.
    The ``distance`` d̂ is below the smallest height of a triangle, the ``pressure``, N/m², that
    between two sheets d̂/2 apart.
    """

    def __init__(
        self, mesh: Mesh, positions: Points, *, distance: Metres, pressure: float, reach: Metres
    ) -> None:
        self._ipctk = import_ipctk()
        self._vertices = len(mesh.rest)
        self._distance = distance
        rest = np.column_stack([mesh.rest, np.zeros(self._vertices)])  # defines the areas
        self._mesh = self._ipctk.CollisionMesh(rest, mesh.edges, mesh.faces)
        self._barrier = self._ipctk.BarrierPotential(distance, pressure / _PRESSURE_AT_HALF,
                                                     use_physical_barrier=True)
        couples = self._near(positions, reach)
        self._keys = couples @ [self._vertices, 1]
        vertex = 3 * np.arange(self._vertices)[:, None] + np.arange(3)
        alone = np.concatenate([vertex, np.full_like(vertex, -1)], axis=1)
        self.dofs = np.concatenate([alone, vertex[couples].reshape(-1, 6)])

    def hessian(self, q: StateVector, convex: bool = False) -> np.ndarray:
        return self._blocks(q, "CLAMP" if convex else "NONE")[0]

    def _add_forces(self, q: StateVector, targets: np.ndarray, forces: np.ndarray) -> float:
        contacts = self._find_pairs(q)
        if contacts[0].empty():
            return 0.0
        forces[targets[: self._vertices, :3].ravel()] += self._barrier.gradient(*contacts)
        return float(self._barrier(*contacts))

    def allows(self, old: StateVector, new: StateVector) -> bool:
        """False if the cloth passes through itself during the step, or covers more than four fifths
        of the way to it; see :func:`sim.energies.fold_barrier.keeps_distance`."""
        before, after = self._positions(old), self._positions(new)
        return self._ipctk.is_step_collision_free(self._mesh, before,
                                                  before + _STEP_MARGIN * (after - before))

    def is_complete(self, q: StateVector) -> bool:
        """Whether the pattern contains all pairs in contact at ``q``."""
        return self._blocks(q, "NONE")[1]

    def _positions(self, q: StateVector) -> np.ndarray:
        return np.asfortranarray(q[: 3 * self._vertices].reshape(-1, 3))

    def _find_pairs(self, q: StateVector) -> tuple:
        """The toolkit's pairs in contact, its mesh and the positions (V, 3)."""
        x = self._positions(q)
        pairs = self._ipctk.NormalCollisions()
        pairs.use_area_weighting = True
        pairs.collision_set_type = pairs.CollisionSetType.IMPROVED_MAX_APPROX
        pairs.build(self._mesh, x, self._distance)
        return pairs, self._mesh, x

    def _blocks(self, q: StateVector, projection: str) -> tuple[np.ndarray, bool]:
        """Blocks (N, 6, 6) with the toolkit's ``projection``, and whether the pattern has room."""
        contacts, result = self._find_pairs(q), np.zeros((*self.dofs.shape, 6))
        if contacts[0].empty():
            return result, True
        method = getattr(self._ipctk.PSDProjectionMethod, projection)
        return result, self._fill(result, self._barrier.hessian(*contacts, method))

    def _fill(self, result: np.ndarray, hessian: sparse.spmatrix) -> bool:
        """Distribute a Hessian (3V, 3V) over ``result`` (N, 6, 6); whether the pattern has room."""
        blocks = sparse.bsr_matrix(hessian, blocksize=(3, 3))
        row = np.repeat(np.arange(self._vertices), np.diff(blocks.indptr))
        column, data = blocks.indices.astype(np.int64), blocks.data
        diagonal, upper = row == column, row < column
        result[row[diagonal], :3, :3] = data[diagonal]
        row, column, data = row[upper], column[upper], data[upper]
        couple = row * self._vertices + column
        found = np.isin(couple, self._keys)
        element = self._vertices + np.searchsorted(self._keys, couple[found])
        result[element, :3, 3:] = data[found]
        result[element, 3:, :3] = np.swapaxes(data[found], 1, 2)
        # [[|B|, -B], [-B', |B|]] is semi-definite: adding it replaces B by a bound on the diagonal.
        lacking = ~found
        bound = np.linalg.norm(data[lacking], axis=(1, 2))[:, None, None] * np.eye(3)
        for vertex in (row, column):
            np.add.at(result[:, :3, :3], vertex[lacking], bound)
        return not lacking.any()

    def _near(self, positions: np.ndarray, reach: float) -> np.ndarray:
        """Couples (C, 2) of vertices, sorted, of all pairs nearer than ``reach``."""
        x = np.asfortranarray(positions)
        edges, faces = self._mesh.edges, self._mesh.faces
        candidates = self._ipctk.Candidates()
        candidates.build(self._mesh, x, reach / 2)
        corners = [
            pair.vertex_ids(edges, faces)
            for pair in [*candidates.fv_candidates, *candidates.ee_candidates]
            if pair.compute_distance(pair.dof(x, edges, faces)) < reach**2  # squared distance
        ]
        corners = np.array(corners, dtype=np.int64).reshape(-1, 4)
        couples = corners[:, np.stack(np.triu_indices(4, 1), axis=-1)].reshape(-1, 2)
        return np.unique(np.sort(couples, axis=1), axis=0)


DISTANCE = 1e-3
"""Distance of two sheets of cloth, m, below which contact acts, about two thicknesses."""
PRESSURE = 20.0
"""Pressure between two sheets at half that distance, as a multiple of the cloth's weight."""
_MAX_SHARE_OF_HEIGHT = 0.5  # limit of the distance on fine meshes, in heights of a triangle
_REACH = 3.0  # pairs within this multiple of the distance are part of the Hessian's pattern


def self_intersections(positions: Points, faces: Faces) -> np.ndarray:
    """Self-intersections (N, 3) of cloth at finite positions: the two vertices of an edge and the
    face that it passes through or touches, without a common vertex. Exact, by floating-point
    predicates with certified signs."""
    ipctk = import_ipctk()
    edges = ipctk.edges(faces)
    boxes = ipctk.LBVH()
    boxes.build(np.asfortranarray(positions), edges, faces)
    near = [(pair.edge_id, pair.face_id) for pair in boxes.detect_edge_face_candidates()]
    edge, face = np.array(near, dtype=np.int64).reshape(-1, 2).T
    apart = (edges[edge][:, :, None] != faces[face][:, None, :]).all(axis=(1, 2))
    edge, face = edge[apart], face[apart]
    corners = positions[np.concatenate([edges[edge], faces[face]], axis=1)]
    crossing = np.array([ipctk.is_edge_intersecting_triangle(*five) for five in corners], bool)
    crossings = np.column_stack([edges[edge], face])[crossing]
    return crossings[np.lexsort(crossings.T)]


def contact_near(scene: Scene, positions: Points) -> SelfContact:
    """Self-contact of cloth near these positions; its energy is zero for most drapes."""
    distance = contact_distance(scene.mesh)
    pressure = PRESSURE * REFERENCE_DENSITY * scene.gravity
    return SelfContact(scene.mesh, positions, distance=distance, pressure=pressure,
                       reach=_REACH * distance)


def contact_distance(mesh: Mesh) -> Metres:
    """Distance below which contact acts on ``mesh``; none acts in a flat specimen."""
    corners = mesh.rest[mesh.faces]
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    return float(min(DISTANCE, _MAX_SHARE_OF_HEIGHT * (2 * mesh.areas / longest).min()))
