"""Flat triangulations: edges, areas, adjacency, smoothing, vertex normals."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse

from common.errors import InputError
from common.types import Edges, Faces, Points, RestPoints, VertexMask


@dataclass(frozen=True, eq=False)
class Mesh:
    """A flat triangulation in material axes (warp along +x, weft along +y)."""

    rest: RestPoints
    faces: Faces  # counter-clockwise seen from +z

    def with_rest(self, rest: RestPoints) -> "Mesh":
        """The mesh of the same triangles with other rest points."""
        mesh = Mesh(rest=rest, faces=self.faces)
        # Tables of the topology are shared: cached properties are stored in __dict__.
        mesh.__dict__["_edge_tables"] = self._edge_tables
        return mesh

    @cached_property
    def areas(self) -> np.ndarray:
        """Rest areas (F,), m²."""
        return 0.5 * doubled_areas(self.rest, self.faces)

    @cached_property
    def vertex_areas(self) -> np.ndarray:
        """Areas (V,) of the vertices, m²: a third of the area of the triangles around each."""
        shares = np.repeat(self.areas / 3, 3)
        return np.bincount(self.faces.ravel(), shares, minlength=len(self.rest))

    @cached_property
    def _edge_tables(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        keys = _sides(self.faces) @ [len(self.rest), 1]  # sorted faster than pairs, in their order
        keys, inverse, counts = np.unique(keys, return_inverse=True, return_counts=True)
        edges = np.column_stack(np.divmod(keys, len(self.rest)))
        if counts.max() > 2:
            raise InputError("the mesh is not a surface: an edge belongs to three triangles")
        order = np.argsort(inverse, kind="stable")
        first = np.cumsum(counts) - counts
        edge_faces = np.full((len(edges), 2), -1)
        edge_faces[:, 0] = order[first] // 3
        shared = counts == 2
        edge_faces[shared, 1] = order[first[shared] + 1] // 3
        return edges, inverse.reshape(-1, 3), edge_faces

    @property
    def edges(self) -> Edges:
        """Vertex pairs, smaller index first."""
        return self._edge_tables[0]

    @cached_property
    def edge_lengths(self) -> np.ndarray:
        """Rest lengths (E,) of the edges, m."""
        ends = self.rest[self.edges]
        return np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)

    @property
    def face_edges(self) -> np.ndarray:
        """Edges (F, 3) opposite each corner of the faces."""
        return self._edge_tables[1]

    @property
    def edge_faces(self) -> np.ndarray:
        """Faces (E, 2) on both sides of the edges, -1 beyond the boundary."""
        return self._edge_tables[2]


def doubled_areas(points: RestPoints, faces: Faces) -> np.ndarray:
    """Twice the areas (F,) of triangles, m²; negative if clockwise."""
    a, b, c = (points[faces[:, k]] for k in range(3))
    u, v = b - a, c - a
    return u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]


def edges_of(faces: Faces) -> tuple[Edges, np.ndarray]:
    """Edges of any triangles, smaller index first, and the number (E,) of triangles at each."""
    return np.unique(_sides(faces), axis=0, return_counts=True)


def _sides(faces: np.ndarray) -> np.ndarray:
    """Sides (3 F, 2) of triangles as vertex pairs, smaller first; side i is opposite corner i."""
    return np.sort(faces[:, [[1, 2], [2, 0], [0, 1]]].reshape(-1, 2), axis=1)


def adjacency(mesh: Mesh) -> sparse.csr_matrix:
    """Adjacency matrix (V, V) of the vertices: ones for pairs joined by an edge."""
    first, second = mesh.edges.T
    size = (len(mesh.rest),) * 2
    one_way = sparse.coo_matrix((np.ones(len(first)), (first, second)), shape=size)
    return (one_way + one_way.T).tocsr()


def smooth(positions: Points, moving: VertexMask, adjacent: sparse.csr_matrix) -> None:
    """Move vertices half-way to the mean of their neighbours, in place (:func:`adjacency`)."""
    degree = np.diff(adjacent.indptr)[:, None]
    positions[moving] = 0.5 * (positions + adjacent @ positions / degree)[moving]


def vertex_normals(positions: Points, faces: Faces) -> np.ndarray:
    """Unit normals (V, 3): area-weighted means over adjacent faces."""
    a, b, c = (positions[faces[:, k]] for k in range(3))
    across = np.cross(b - a, c - a)
    total = np.zeros_like(positions)
    for k in range(3):
        np.add.at(total, faces[:, k], across)
    return total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-30)
