"""One numbering of a cloth's unknowns for all triangulations of a grid.

Perturbed meshes differ in which diagonal each cell has and in which vertices the rig holds.
Numbered by grid place instead of by mesh, their Hessians share a pattern: it holds the
couplings of both diagonals of every cell, and one rotation for a cell's diagonal, whichever way
it runs. A wider one couples neighbouring triangles, too.
"""

from functools import cached_property

import numpy as np

from common.errors import InputError
from sim.linear import SparsePattern
from sim.mesh import Mesh


class GridUnknowns:
    """The unknowns that some sample of a batch of grid meshes may have, as rows of a matrix.

    Args:
        shape: (nx, ny) vertices, numbered i*ny + j.
        free: (nx, ny) bool, vertices that are free in at least one sample.

    Attributes:
        size: number of rows, n: three coordinates of each free vertex and one rotation of each
            grid edge and each cell of which a corner is free.
        places: (n, 2) grid place of each row, in spacings.
    """

    def __init__(self, shape: tuple[int, int], free: np.ndarray) -> None:
        if free.shape != tuple(shape) or min(shape) < 3 or not free.any():
            raise InputError(f"a grid {shape} of at least 3 x 3 vertices, some of them free, "
                             f"does not go with a mask {free.shape}")
        self.shape = nx, ny = shape
        vertices = np.stack(np.meshgrid(np.arange(nx), np.arange(ny), indexing="ij"), axis=-1)
        along, across = free[:-1] | free[1:], free[:, :-1] | free[:, 1:]
        cells = along[:, :-1] | along[:, 1:]
        used = np.concatenate([np.repeat(free, 3), along.ravel(), across.ravel(), cells.ravel()])
        rotations = [
            (vertices[:-1, :] + np.array([0.5, 0.0])).reshape(-1, 2),
            (vertices[:, :-1] + np.array([0.0, 0.5])).reshape(-1, 2),
            (vertices[:-1, :-1] + 0.5).reshape(-1, 2),
        ]
        where = np.concatenate([np.repeat(vertices.reshape(-1, 2), 3, axis=0), *rotations])
        self.size = int(used.sum())
        self.places = where[used]
        self._row = np.full(len(used), -1)
        self._row[used] = np.arange(self.size)

    @cached_property
    def pattern(self) -> SparsePattern:
        """Of Hessians in the frames of edges, where triangles couple with themselves alone."""
        return self._pattern([triangle for triangle, _ in self._triangles()])

    @cached_property
    def wide_pattern(self) -> SparsePattern:
        """Of all Hessians whose elements reach no further than a triangle and its neighbours."""
        return self._pattern(
            [np.concatenate(parts, axis=1) for parts in self._triangles()]
        )

    def _pattern(self, stencils: list[np.ndarray]) -> SparsePattern:
        return SparsePattern(
            [np.where(stencil >= 0, self._row[stencil], -1) for stencil in stencils], self.size
        )

    def rows(self, mesh: Mesh, free: np.ndarray) -> np.ndarray:
        """(Q,) row of each unknown of one sample's mesh, -1 for those that are not free.

        Args:
            mesh: a triangulation of the grid, its faces from :func:`sim.mesh.grid_faces`.
            free: (Q,) bool, Q = 3V + E, as for :class:`sim.potential.Potential`.

        Raises:
            InputError: a mesh of another grid, or a free unknown that has no row.
        """
        nx, ny = self.shape
        low, high = mesh.edges.T
        i, j = np.divmod(low, ny)
        step = high - low
        # A diagonal from (i, j) to (i+1, j+1) belongs to the cell (i, j), one from (i, j) to
        # (i+1, j-1) to the cell (i, j-1).
        along, across = step == ny, step == 1
        cell = i * (ny - 1) + j - (step == ny - 1)
        if len(mesh.rest) != nx * ny or not (along | across | (abs(step - ny) == 1)).all():
            raise InputError(f"the mesh is no triangulation of a grid of {nx} x {ny} vertices")
        first = np.cumsum([3 * nx * ny, (nx - 1) * ny, nx * (ny - 1)])
        number = np.where(along, first[0] + low, np.where(across, first[1] + cell, first[2] + cell))
        row = self._row[np.concatenate([np.arange(3 * nx * ny), number])]
        if (row[free] < 0).any():
            raise InputError("a free unknown of the mesh has no row: its vertex is always held")
        return np.where(free, row, -1)

    def embed(self, pattern: SparsePattern, data: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """CSR data (nnz,) in the shared :attr:`pattern` of one sample's own matrix.

        Rows that the sample has no unknown for get a one on the diagonal.

        Args:
            pattern, data: the sample's matrix, of m rows.
            rows: (m,) shared row of each of them.

        Raises:
            InputError: a coupling that the shared pattern has not.
        """
        own_row = np.repeat(np.arange(pattern.size), np.diff(pattern.indptr))
        pairs = np.stack([rows[own_row], rows[pattern.indices]], axis=1)
        result = np.zeros(len(self.pattern.indices))
        absent = np.ones(self.size, dtype=bool)
        absent[rows] = False
        result[self.pattern.diagonal[absent]] = 1.0
        result[self.pattern.slots(pairs)[:, 1]] = data
        return result

    def _triangles(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """Each triangle that some choice of diagonals makes, and what lies around it.

        For each of a cell's four: (cells, 12) unknowns of its corners and of its edges; (cells, 15)
        those of the cell's fourth corner and of the far corners of the cells across its two grid
        edges, where its neighbours may have theirs.
        """
        nx, ny = self.shape
        i, j = (a.ravel() for a in np.indices((nx - 1, ny - 1)))
        along = 3 * nx * ny + np.arange((nx - 1) * ny).reshape(nx - 1, ny)
        across = along.size + along[0, 0] + np.arange(nx * (ny - 1)).reshape(nx, ny - 1)
        diagonal = across[-1, -1] + 1 + i * (ny - 1) + j

        def vertices(a: np.ndarray, b: np.ndarray) -> np.ndarray:
            """(cells, 3) coordinates of the vertices (a, b), -1 outside the grid."""
            inside = (a >= 0) & (a < nx) & (b >= 0) & (b < ny)
            return np.where(inside[:, None], 3 * (a * ny + b)[:, None] + np.arange(3), -1)

        triangles = []
        for a in (0, 1):  # the side of the cell across x, and the one across y
            for b in (0, 1):
                edges = np.stack([across[i + a, j], along[i, j + b], diagonal], axis=1)
                corners = [vertices(i + k, j + m) for k, m in ((a, b), (1 - a, b), (a, 1 - b))]
                around = [vertices(i + 1 - a, j + 1 - b)]
                around += [vertices(i + 3 * a - 1, j + k) for k in (0, 1)]
                around += [vertices(i + k, j + 3 * b - 1) for k in (0, 1)]
                triangles.append((np.concatenate([*corners, edges], axis=1),
                                  np.concatenate(around, axis=1)))
        return triangles
