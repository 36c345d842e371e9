"""Specimen meshes: grids of triangles with conforming held regions, and their topology."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse

from common.errors import InputError

DIAGONALS = ("random", "alternating", "equal")
RESOLUTIONS = (8, 401)
"""Vertices a side, or across a disc: fewest, for the plate's rim; most, for memory and time."""


@dataclass(frozen=True)
class Mesh:
    """A flat triangulation in material axes (warp along +x, weft along +y).

    Attributes:
        rest: (V, 2) float64 rest positions, m.
        faces: (F, 3) int64 corners, counter-clockwise seen from +z.
    """

    rest: np.ndarray
    faces: np.ndarray

    @cached_property
    def areas(self) -> np.ndarray:
        """(F,) rest areas, m²."""
        a, b, c = (self.rest[self.faces[:, i]] for i in range(3))
        u, v = b - a, c - a
        return 0.5 * (u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])

    @cached_property
    def vertex_areas(self) -> np.ndarray:
        """(V,) a third of the area of the triangles around each vertex, m²."""
        return np.bincount(
            self.faces.ravel(), np.repeat(self.areas / 3, 3), minlength=len(self.rest)
        )

    @cached_property
    def _edge_tables(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        # Edge i of a face lies opposite its corner i.
        directed = self.faces[:, [[1, 2], [2, 0], [0, 1]]].reshape(-1, 2)
        edges, inverse = np.unique(np.sort(directed, axis=1), axis=0, return_inverse=True)
        face_edges = inverse.reshape(-1, 3)
        order = np.argsort(face_edges.ravel(), kind="stable")
        counts = np.bincount(face_edges.ravel(), minlength=len(edges))
        if counts.max() > 2:
            raise InputError("the mesh is not a surface: an edge belongs to three triangles")
        first = np.concatenate([[0], np.cumsum(counts)[:-1]])
        edge_faces = np.full((len(edges), 2), -1)
        edge_faces[:, 0] = order[first] // 3
        shared = counts == 2
        edge_faces[shared, 1] = order[first[shared] + 1] // 3
        return edges, face_edges, edge_faces

    @property
    def edges(self) -> np.ndarray:
        """(E, 2) vertex pairs, smaller index first."""
        return self._edge_tables[0]

    @property
    def face_edges(self) -> np.ndarray:
        """(F, 3) the edge opposite each corner."""
        return self._edge_tables[1]

    @property
    def edge_faces(self) -> np.ndarray:
        """(E, 2) the faces on either side, -1 where there is none."""
        return self._edge_tables[2]

    @cached_property
    def neighbours(self) -> np.ndarray:
        """(F, 3) for each corner, the vertex beyond the opposite edge; -1 at the boundary."""
        across = self.edge_faces[self.face_edges]  # (F, 3, 2)
        here = np.arange(len(self.faces))[:, None]
        other = np.where(across[..., 0] == here, across[..., 1], across[..., 0])
        corner_sum = self.faces[other].sum(-1) - self.edges[self.face_edges].sum(-1)
        return np.where(other >= 0, corner_sum, -1)


def check_resolution(resolution: int) -> None:
    """InputError for a specimen of fewer or more vertices a side than :data:`RESOLUTIONS`."""
    fewest, most = RESOLUTIONS
    if not fewest <= resolution <= most or resolution != int(resolution):
        raise InputError(f"resolution={resolution} must be a whole number of vertices a side, "
                         f"between {fewest} and {most}")


def edges_of(faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Edges (E, 2) of triangles (F, 3), smaller index first, and how many triangles each has (E,).

    For any triangles; those of a specimen are :class:`Mesh`'s.
    """
    pairs = np.sort(faces[:, [[1, 2], [2, 0], [0, 1]]].reshape(-1, 2), axis=1)
    return np.unique(pairs, axis=0, return_counts=True)


def grid_faces(diagonals: np.ndarray) -> np.ndarray:
    """Faces (2*(nx-1)*(ny-1), 3) of a grid of nx × ny vertices numbered i*ny + j.

    ``diagonals`` (nx-1, ny-1) bool: whether a cell's diagonal runs from its corner (i, j) to
    (i+1, j+1) rather than between the other two. Counter-clockwise for i along x, j along y.
    """
    nx, ny = diagonals.shape[0] + 1, diagonals.shape[1] + 1
    index = np.arange(nx * ny).reshape(nx, ny)
    a, b = index[:-1, :-1], index[1:, :-1]
    c, d = index[1:, 1:], index[:-1, 1:]
    main = np.stack([a, b, c, a, c, d], axis=-1)
    cross = np.stack([a, b, d, b, c, d], axis=-1)
    return np.where(diagonals[..., None], main, cross).reshape(-1, 3)


def adjacency(mesh: Mesh) -> sparse.csr_matrix:
    """(V, V) with a one for each two vertices that an edge joins."""
    first, second = mesh.edges.T
    size = (len(mesh.rest),) * 2
    one_way = sparse.coo_matrix((np.ones(len(first)), (first, second)), shape=size)
    return (one_way + one_way.T).tocsr()


def smooth(positions: np.ndarray, moving: np.ndarray, adjacent: sparse.csr_matrix) -> None:
    """Move positions (V, 3) where ``moving`` (V,) half-way to the mean of their neighbours.

    In place; ``adjacent`` as :func:`adjacency` gives it.
    """
    degree = np.diff(adjacent.indptr)[:, None]
    positions[moving] = 0.5 * (positions + adjacent @ positions / degree)[moving]


def vertex_normals(positions: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Unit normals (V, 3) at positions (V, 3): of the faces (F, 3) around, weighted by area."""
    a, b, c = (positions[faces[:, k]] for k in range(3))
    across = np.cross(b - a, c - a)
    total = np.zeros_like(positions)
    for k in range(3):
        np.add.at(total, faces[:, k], across)
    return total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-30)


def choose_diagonals(shape: tuple[int, int], kind: str, rng: np.random.Generator) -> np.ndarray:
    """Diagonals (nx-1, ny-1) bool of a grid of ``shape`` (nx, ny) vertices; see DIAGONALS."""
    cells = (shape[0] - 1, shape[1] - 1)
    if kind == "random":
        return rng.random(cells) < 0.5
    if kind == "alternating":
        return np.indices(cells).sum(0) % 2 == 0
    if kind == "equal":
        return np.ones(cells, dtype=bool)
    raise InputError(f"unknown diagonals '{kind}'; choose from {', '.join(DIAGONALS)}")


def grid_points(
    shape: tuple[int, int], size: tuple[float, float], jitter: float, rng: np.random.Generator
) -> np.ndarray:
    """Points (nx, ny, 2), m, of a grid over [0, size]², inner ones moved at random.

    Each coordinate moves by at most ``jitter`` times the spacing; points on a side stay on it.
    """
    axes = [np.linspace(0.0, size[k], shape[k]) for k in range(2)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    moves = rng.uniform(-jitter, jitter, points.shape)
    moves *= np.array([size[k] / (shape[k] - 1) for k in range(2)])
    moves[[0, -1], :, 0] = 0.0
    moves[:, [0, -1], 1] = 0.0
    return points + moves


def strip(
    *,
    length: float,
    width: float,
    edge: float,
    clamp: float,
    diagonals: str = "alternating",
    jitter: float = 0.0,
    seed: int = 0,
) -> tuple[Mesh, np.ndarray]:
    """A strip along +x that starts with a clamped piece of length ``clamp`` at x < 0.

    Args:
        length, width, edge, clamp: m; the spacing is ``edge`` along and across.
        jitter: as in :func:`grid_points`; the column x = 0 stays in place.

    Returns:
        The mesh and the mask (V,) bool of the clamped vertices, x <= 0.

    Raises:
        InputError: a clamp that is no multiple of ``edge``.
    """
    rng = np.random.default_rng(seed)
    held_columns, columns = round(clamp / edge), round(length / edge)
    if not np.isclose(held_columns * edge, clamp, rtol=1e-6):
        raise InputError(f"clamp={clamp:g} m must be a multiple of the spacing {edge:g} m")
    shape = (held_columns + columns + 1, round(width / edge) + 1)
    points = grid_points(shape, (clamp + length, width), jitter, rng)
    points[..., 0] -= clamp
    points[held_columns, :, 0] = 0.0
    cells = choose_diagonals(shape, diagonals, rng)
    mesh = Mesh(rest=points.reshape(-1, 2), faces=grid_faces(cells))
    return mesh, mesh.rest[:, 0] <= 1e-9 * length


def draped_square(
    *,
    size: float,
    plate_radius: float,
    resolution: int,
    offset: tuple[float, float] = (0.0, 0.0),
    diagonals: str = "random",
    jitter: float = 0.15,
    seed: int = 0,
) -> tuple[Mesh, np.ndarray, np.ndarray]:
    """A square specimen whose mesh follows the rim of the plate it lies on.

    On a plain grid the held vertices form a staircase that misses up to 15 % of the plate's
    area, which changes a drape more than refinement does; here the grid's vertices nearest the
    rim are moved onto it, and no triangle straddles the rim.

    Args:
        size: side, m.
        plate_radius: m.
        resolution: vertices per side, within :data:`RESOLUTIONS`.
        offset: specimen's centre relative to the plate's axis, m, in material axes.
        diagonals, jitter, seed: the perturbed triangulation; see :func:`choose_diagonals` and
            :func:`grid_points`.

    Returns:
        The mesh (origin of ``rest`` on the plate's axis), the mask (V,) bool of the held
        vertices, and the diagonals (n-1, n-1) bool.

    Raises:
        InputError: too few or many vertices, or the plate does not lie within the specimen.
    """
    check_resolution(resolution)
    if size / 2 - max(abs(offset[0]), abs(offset[1])) < plate_radius + 2 * size / resolution:
        raise InputError("the specimen's offset leaves the plate uncovered; reduce the offset")
    rng = np.random.default_rng(seed)
    shape = (resolution, resolution)
    points = grid_points(shape, (size, size), jitter, rng) - size / 2 + np.asarray(offset)
    on_rim = _move_onto_rim(points, plate_radius)
    radius = np.linalg.norm(points, axis=-1)
    inside = (radius < plate_radius) & ~on_rim
    cells = choose_diagonals(shape, diagonals, rng)
    cells = _follow_rim(cells, inside, on_rim)
    _relax_near_rim(points, cells, inside, on_rim, plate_radius)
    mesh = Mesh(rest=points.reshape(-1, 2), faces=grid_faces(cells))
    return mesh, (inside | on_rim).ravel(), cells


def _move_onto_rim(points: np.ndarray, radius: float) -> np.ndarray:
    """Move points (n, n, 2) onto the rim until no grid edge crosses it; the mask (n, n) moved.

    Crossing edges are taken once, shortest move first, so the result has no preferred side.
    """
    n = len(points)
    signed = np.linalg.norm(points, axis=-1).ravel() - radius
    index = np.arange(n * n).reshape(n, n)
    edges = np.concatenate(
        [
            np.stack([index[:-1], index[1:]], axis=-1).reshape(-1, 2),
            np.stack([index[:, :-1], index[:, 1:]], axis=-1).reshape(-1, 2),
        ]
    )
    crossing = edges[signed[edges[:, 0]] * signed[edges[:, 1]] < 0]
    distance = np.abs(signed)
    crossing = crossing[np.argsort(distance[crossing].min(axis=1), kind="stable")]
    moved = np.zeros(n * n, dtype=bool)
    for a, b in crossing:
        if not (moved[a] or moved[b]):
            moved[a if distance[a] <= distance[b] else b] = True
    flat = points.reshape(-1, 2)
    flat[moved] *= radius / np.linalg.norm(flat[moved], axis=1, keepdims=True)
    return moved.reshape(n, n)


def _follow_rim(cells: np.ndarray, inside: np.ndarray, on_rim: np.ndarray) -> np.ndarray:
    """Turn diagonals that cross the rim or leave a sliver between three rim vertices."""
    outside = ~(inside | on_rim)

    def corners(mask: np.ndarray) -> tuple[np.ndarray, ...]:
        return mask[:-1, :-1], mask[1:, :-1], mask[1:, 1:], mask[:-1, 1:]

    (ia, ib, ic, id_), (oa, ob, oc, od) = corners(inside), corners(outside)
    main_crosses = (ia & oc) | (oa & ic)
    cross_crosses = (ib & od) | (ob & id_)
    ra, rb, rc, rd = corners(on_rim)
    # Main diagonal a-c makes triangles abc, acd; the other, b-d, makes abd, bcd.
    main_sliver = (ra & rc) & (rb | rd)
    cross_sliver = (rb & rd) & (ra | rc)
    cells = np.where(main_sliver & ~cross_sliver, False, cells)
    cells = np.where(cross_sliver & ~main_sliver, True, cells)
    cells = np.where(main_crosses, False, cells)
    return np.where(cross_crosses, True, cells)


def _relax_near_rim(
    points: np.ndarray,
    cells: np.ndarray,
    inside: np.ndarray,
    on_rim: np.ndarray,
    radius: float,
    rounds: int = 10,
) -> None:
    """Even out, in place, the triangles that moving vertices onto the rim has squeezed.

    Laplacian smoothing of the vertices within two cells of the rim; those on it slide along.
    """
    n = len(points)
    flat = points.reshape(-1, 2)
    edges = Mesh(rest=flat, faces=grid_faces(cells)).edges
    near = on_rim.copy()
    for _ in range(2):
        grown = near.copy()
        grown[1:] |= near[:-1]
        grown[:-1] |= near[1:]
        grown[:, 1:] |= near[:, :-1]
        grown[:, :-1] |= near[:, 1:]
        near = grown
    near[[0, -1]] = False
    near[:, [0, -1]] = False
    near, rim = near.ravel(), on_rim.ravel()
    degree = np.bincount(edges.ravel(), minlength=n * n)[:, None]
    for _ in range(rounds):
        total = np.zeros_like(flat)
        np.add.at(total, edges[:, 0], flat[edges[:, 1]])
        np.add.at(total, edges[:, 1], flat[edges[:, 0]])
        flat[near] = 0.5 * flat[near] + 0.5 * (total / degree)[near]
        flat[rim] *= radius / np.linalg.norm(flat[rim], axis=1, keepdims=True)
