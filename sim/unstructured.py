"""Unstructured triangulations of squares, discs and strips that follow given lines.

Points are spread over the specimen, relaxed towards equilateral triangles and joined by
Delaunay's rule. Points on the specimen's border and on the line between held and free cloth stay
where they are, and the triangulation follows both. All specimens are convex.
"""

import numpy as np
from scipy.spatial import Delaunay, QhullError, cKDTree

from common.errors import InputError
from common.threads import one_blas_thread
from sim.mesh import Mesh

_ROUNDS = 40
_CORRECTIONS = (10, 17, 24)  # rounds after which points are taken away and added
_CLEAR = 0.6
"""Least distance of a point from the middle of a line segment, in the segment's lengths. Above
one half, no point lies in the circle over the segment, so that Delaunay's rule keeps it."""


def unstructured_square(
    *,
    size: float,
    edge: float,
    plate_radius: float | None = None,
    offset: tuple[float, float] = (0.0, 0.0),
    seed: int = 0,
) -> tuple[Mesh, np.ndarray]:
    """A square specimen; with ``plate_radius``, the mesh follows the rim of the plate.

    Args:
        size, edge, plate_radius: side of the square, mean edge length, radius of the plate, m.
        offset: of the specimen's centre from the plate's axis, m.
        seed: of the points.

    Returns:
        The mesh, origin of ``rest`` on the plate's axis, and the mask (V,) bool of the vertices
        on the plate.

    Raises:
        InputError: the edges are too long for the specimen and its overhang.
    """
    half = size / 2
    corners = np.array([[-half, -half], [half, -half], [half, half], [-half, half]])
    border = _polygon(corners + np.asarray(offset), edge)
    return _on_plate(border, edge, plate_radius, seed)


def unstructured_disc(
    *,
    diameter: float,
    edge: float,
    plate_radius: float,
    offset: tuple[float, float] = (0.0, 0.0),
    seed: int = 0,
) -> tuple[Mesh, np.ndarray]:
    """A disc specimen on a plate; arguments, result and errors of :func:`unstructured_square`."""
    return _on_plate(_circle(diameter / 2, edge) + np.asarray(offset), edge, plate_radius, seed)


def unstructured_strip(
    *, length: float, width: float, edge: float, clamp: float, seed: int = 0
) -> tuple[Mesh, np.ndarray]:
    """A strip along +x that starts with a clamped piece of length ``clamp`` at x < 0.

    Arguments in m. Returns the mesh, which follows the line x = 0, and the mask (V,) bool of the
    clamped vertices, x <= 0; compare :func:`sim.mesh.strip`.
    """
    free = _polygon(np.array([[0.0, 0.0], [length, 0.0], [length, width], [0.0, width]]), edge)
    held = _polygon(np.array([[-clamp, 0.0], [0.0, 0.0], [0.0, width], [-clamp, width]]), edge)
    on_line = held[np.abs(held[:, 0]) < 1e-9 * length]
    border = np.concatenate([held[held[:, 0] < -1e-9 * length], free[free[:, 0] > 1e-9 * length],
                             on_line[[0, -1]]])
    around = np.arctan2(border[:, 1] - width / 2, border[:, 0] - (length - clamp) / 2)
    border = border[np.argsort(around)]
    line = on_line[np.argsort(on_line[:, 1])]
    lines = [_closed(border), np.stack([line[:-1], line[1:]], axis=1)]
    mesh = triangulate(np.concatenate(lines), edge, np.random.default_rng(seed))
    return mesh, mesh.rest[:, 0] <= 1e-9 * length


def _on_plate(
    border: np.ndarray, edge: float, plate_radius: float | None, seed: int
) -> tuple[Mesh, np.ndarray]:
    lines = [_closed(border)]
    if plate_radius is not None:
        lines.append(_closed(_circle(plate_radius, edge)))
    mesh = triangulate(np.concatenate(lines), edge, np.random.default_rng(seed))
    limit = -1.0 if plate_radius is None else plate_radius * (1 + 1e-9)
    return mesh, np.linalg.norm(mesh.rest, axis=1) <= limit


def _circle(radius: float, edge: float) -> np.ndarray:
    """Points (n, 2) on a circle around the origin, about ``edge`` apart."""
    angle = np.linspace(0, 2 * np.pi, max(8, round(2 * np.pi * radius / edge)), endpoint=False)
    return radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def _polygon(corners: np.ndarray, edge: float) -> np.ndarray:
    """Points (n, 2) along a closed polygon (k, 2), about ``edge`` apart, corners included."""
    sides = zip(corners, np.roll(corners, -1, axis=0), strict=True)
    parts = []
    for a, b in sides:
        count = max(1, round(float(np.linalg.norm(b - a)) / edge))
        parts.append(a + np.linspace(0, 1, count, endpoint=False)[:, None] * (b - a))
    return np.concatenate(parts)


def _closed(points: np.ndarray) -> np.ndarray:
    """Segments (n, 2, 2) of the closed line through points (n, 2)."""
    return np.stack([points, np.roll(points, -1, axis=0)], axis=1)


def triangulate(segments: np.ndarray, edge: float, rng: np.random.Generator) -> Mesh:
    """Triangulation of the convex hull of line segments that has every segment as an edge.

    Args:
        segments: (S, 2, 2) end points, m, each about ``edge`` long; crossing none other.
        edge: length of the edges, m.
        rng: for the first positions of the points.

    Raises:
        InputError: a segment is no edge, because lines come closer than the edges' length.
    """
    fixed = np.unique(segments.reshape(-1, 2), axis=0)
    points = np.concatenate([fixed, _scattered(fixed, edge, rng)])
    lengths = np.linalg.norm(segments[:, 1] - segments[:, 0], axis=1)
    middles = cKDTree(segments.mean(axis=1))
    for count in range(1, _ROUNDS + 1):
        points[len(fixed) :] = _relaxed(points, _delaunay(points))[len(fixed) :]
        _keep_clear(points[len(fixed) :], middles, _CLEAR * lengths)
        if count in _CORRECTIONS:
            points = _corrected(points, _delaunay(points), len(fixed), edge)
    mesh = Mesh(rest=points, faces=_delaunay(points))
    ends = cKDTree(points).query(segments)[1]
    if not np.isin(_keys(ends, len(points)), _keys(mesh.edges, len(points))).all():
        raise InputError(
            f"edges of {1e3 * edge:.3g} mm are too long for this specimen; refine the mesh"
        )
    return mesh


def _keys(edges: np.ndarray, count: int) -> np.ndarray:
    """One number (E,) for each pair of vertices (E, 2), whatever their order."""
    low_high = np.sort(edges, axis=1)
    return low_high[:, 0] * count + low_high[:, 1]


@one_blas_thread
def _scattered(fixed: np.ndarray, edge: float, rng: np.random.Generator) -> np.ndarray:
    """Points (n, 2) inside the hull of ``fixed`` (m, 2), not too close to those.

    A triangular lattice in a random position, shaken until its order is lost.
    """
    centre = (fixed.min(0) + fixed.max(0)) / 2
    reach = np.linalg.norm(fixed - centre, axis=1).max() + edge
    count = int(np.ceil(reach / (np.sqrt(0.75) * edge)))
    i, j = (v.ravel() for v in np.mgrid[-count : count + 1, -count : count + 1])
    lattice = edge * np.stack([i + 0.5 * (j % 2), np.sqrt(0.75) * j], axis=1)
    lattice += rng.uniform(-0.5, 0.5, 2) * edge + rng.uniform(-0.5, 0.5, lattice.shape) * edge
    angle = rng.uniform(0, 2 * np.pi)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    points = centre + lattice @ turn.T
    inside = Delaunay(fixed).find_simplex(points) >= 0
    return points[inside & (cKDTree(fixed).query(points)[0] > 0.7 * edge)]


def _delaunay(points: np.ndarray) -> np.ndarray:
    """Faces (F, 3), counter-clockwise, without the flat ones along straight borders."""
    try:
        faces = Delaunay(points).simplices.astype(np.int64)
    except QhullError:
        raise InputError("the specimen's mesh has collapsed; refine it") from None
    a, b, c = (points[faces[:, k]] for k in range(3))
    u, v = b - a, c - a
    twice = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
    faces[twice < 0] = faces[twice < 0][:, [0, 2, 1]]
    return faces[np.abs(twice) > 1e-6 * np.median(np.abs(twice))]


def _relaxed(points: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Each point at the mean of the circumcentres around it, weighted with their triangles' areas.

    The fixed point of this map minimises the error of linear interpolation of a paraboloid,
    which makes triangles nearly equilateral (optimal Delaunay triangulation).
    """
    a, b, c = (points[faces[:, k]] for k in range(3))
    u, v = b - a, c - a
    twice = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
    uu, vv = (u**2).sum(1)[:, None], (v**2).sum(1)[:, None]
    perpendicular = uu * np.stack([v[:, 1], -v[:, 0]], 1) + vv * np.stack([-u[:, 1], u[:, 0]], 1)
    centres = a + perpendicular / (2 * twice[:, None])
    # The circumcentre of an obtuse triangle lies outside; it must not pull points out with it.
    centroid = (a + b + c) / 3
    limit = np.sqrt(np.abs(twice) / 2)
    reach = np.linalg.norm(centres - centroid, axis=1)
    centres = centroid + (centres - centroid) * np.minimum(1.0, limit / reach.clip(1e-300))[:, None]
    weight = np.bincount(faces.ravel(), np.repeat(twice, 3), minlength=len(points))
    return np.stack(
        [np.bincount(faces.ravel(), np.repeat(twice * centres[:, k], 3), minlength=len(points))
         for k in range(2)], axis=1
    ) / weight[:, None]


def _corrected(points: np.ndarray, faces: np.ndarray, fixed: int, edge: float) -> np.ndarray:
    """Points without those crowded by a neighbour, and with new ones where edges are too long.

    The first ``fixed`` ones stay.
    """
    edges = Mesh(rest=points, faces=faces).edges  # the larger index, free if one is, second
    length = np.linalg.norm(points[edges[:, 1]] - points[edges[:, 0]], axis=1)
    gone, touched = np.zeros(len(points), bool), np.zeros(len(points), bool)
    for k in np.flatnonzero((length < 0.67 * edge) & (edges[:, 1] >= fixed)):
        if not touched[edges[k]].any():
            gone[edges[k, 1]] = True
            touched[edges[k]] = True
    added = []
    for k in np.flatnonzero((length > 1.45 * edge) & (edges[:, 1] >= fixed)):
        if not touched[edges[k]].any():
            added.append(points[edges[k]].mean(axis=0))
            touched[edges[k]] = True
    return np.concatenate([points[~gone], np.reshape(added, (-1, 2))])


def _keep_clear(points: np.ndarray, middles: cKDTree, least: np.ndarray) -> None:
    """Move points (n, 2), in place, away from segments whose middles they are closest to."""
    distance, nearest = middles.query(points)
    close = distance < least[nearest]
    towards = points[close] - middles.data[nearest[close]]
    points[close] += towards * (least[nearest[close]] / distance[close] - 1)[:, None]
