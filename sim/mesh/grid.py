"""Triangulated grids, for strips and for comparisons on regular meshes."""

import numpy as np

from common.types import Metres, VertexMask
from sim.mesh.topology import Mesh


def grid_faces(diagonals: np.ndarray) -> np.ndarray:
    """Faces (2*(nx-1)*(ny-1), 3), counter-clockwise, of a grid of nx × ny vertices i*ny + j, i in
    x, j in y. ``diagonals`` (nx-1, ny-1) bool: whether a cell's joins (i, j) and (i+1, j+1)."""
    nx, ny = diagonals.shape[0] + 1, diagonals.shape[1] + 1
    index = np.arange(nx * ny).reshape(nx, ny)
    a, b = index[:-1, :-1], index[1:, :-1]
    c, d = index[1:, 1:], index[:-1, 1:]
    main = np.stack([a, b, c, a, c, d], axis=-1)
    cross = np.stack([a, b, d, b, c, d], axis=-1)
    return np.where(diagonals[..., None], main, cross).reshape(-1, 3)


def choose_diagonals(shape: tuple[int, int], kind: str, rng: np.random.Generator) -> np.ndarray:
    """Diagonals (nx-1, ny-1) bool of a grid of ``shape`` (nx, ny) vertices, of the ``kind`` random,
    alternating or equal."""
    cells = (shape[0] - 1, shape[1] - 1)
    if kind == "random":
        return rng.random(cells) < 0.5
    if kind == "alternating":
        return np.indices(cells).sum(0) % 2 == 0
    return np.ones(cells, dtype=bool)


def grid_points(
    shape: tuple[int, int], size: tuple[float, float], jitter: float, rng: np.random.Generator
) -> np.ndarray:
    """Points (nx, ny, 2), m, of a grid over [0, size]², moved at random: each coordinate by at most
    ``jitter`` times the spacing; points on a side move along it."""
    axes = [np.linspace(0.0, size[k], shape[k]) for k in range(2)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    moves = rng.uniform(-jitter, jitter, points.shape)
    moves *= np.array([size[k] / (shape[k] - 1) for k in range(2)])
    moves[[0, -1], :, 0] = 0.0
    moves[:, [0, -1], 1] = 0.0
    return points + moves


def strip(
    *, length: Metres, width: Metres, edge: Metres, clamp: Metres,
    diagonals: str = "alternating", jitter: float = 0.0, seed: int = 0
) -> tuple[Mesh, VertexMask]:
    """A strip along +x with a clamped part of length ``clamp``, a multiple of ``edge``, at x < 0,
    and the clamped vertices, x <= 0; with the ``jitter`` of :func:`grid_points` along the clamp's
    edge only."""
    rng = np.random.default_rng(seed)
    held_columns, columns = round(clamp / edge), round(length / edge)
    shape = (held_columns + columns + 1, round(width / edge) + 1)
    points = grid_points(shape, (clamp + length, width), jitter, rng)
    points[..., 0] -= clamp
    points[held_columns, :, 0] = 0.0
    cells = choose_diagonals(shape, diagonals, rng)
    mesh = Mesh(rest=points.reshape(-1, 2), faces=grid_faces(cells))
    return mesh, mesh.rest[:, 0] <= 1e-9 * length
