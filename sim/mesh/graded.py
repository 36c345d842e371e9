"""Triangulations of squares and discs, fine at the plate's rim and coarser towards the hem.

Within about 25 mm of the rim, cloth is bent in two directions; uniform meshes are too coarse there.
Initial points are on circles around the plate, spaced by the target edge length, with a random
phase. A few rounds of relaxation (optimal Delaunay triangulation, Alliez et al. 2005, with the
target edge length as size field) make the triangles nearly equilateral.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.spatial import Delaunay

from sim.mesh.topology import Mesh, doubled_areas
from sim.rig import Rig

GROWTH = 0.1
"""Increase of the edge length per distance from the rim."""
_GROWTH_HELD = 0.6  # the same on the plate, where triangles store no energy
_JITTER = 0.3  # largest random move of a point before relaxation, in edge lengths
_RELAXATIONS = 4
_CLEARANCE = 0.6
"""Minimum distance of a point from rim and border, in edge lengths. Above 1/2, the circle with an
edge of the rim as diameter contains no point: the edge is part of the Delaunay triangulation."""


@dataclass(frozen=True)
class Outline:
    """Domain and edge lengths of a graded mesh.

    Attributes:
        rig: rig of the specimen, cut along its yarns; without a plate the mesh is uniform.
        centre: of the specimen, m from the plate's axis.
        edge: edge length at the rim, m.
        largest: maximum edge length, m.
    """

    rig: Rig
    centre: tuple[float, float]
    edge: float
    largest: float

    def edge_at(self, points: np.ndarray) -> np.ndarray:
        """Target edge lengths (N,) at points (N, 2), m."""
        if not self.rig.has_plate:
            return np.full(len(points), self.edge)
        outside = np.linalg.norm(points, axis=1) - self.rig.plate_radius
        grown = np.minimum(self.edge + GROWTH * outside, self.largest)
        return np.where(outside < 0, self.edge - _GROWTH_HELD * outside, grown)


def rim_radius(outline: Outline) -> tuple[float, int]:
    """Circumradius, m, and number of corners of the polygon that approximates the rim. It has the
    plate's area; an inscribed polygon would hold too little cloth."""
    corners = max(8, round(2 * np.pi * outline.rig.plate_radius / outline.edge))
    turn = 2 * np.pi / corners
    return outline.rig.plate_radius * np.sqrt(turn / np.sin(turn)), corners


def graded_mesh(outline: Outline, rng: np.random.Generator) -> tuple[Mesh, np.ndarray]:
    """The mesh of ``outline`` and the number of vertices on the plate: they are the first of the
    vertices (V, 2), those of the rim before the others."""
    radius, corners = rim_radius(outline) if outline.rig.has_plate else (0.0, 0)
    parts = [_circle(radius, corners, rng), _rings(outline, rng, radius, -1),
             _rings(outline, rng, radius, 1), _border(outline, rng)]
    rim, held, free, _ = np.cumsum([len(part) for part in parts])
    points = np.concatenate(parts)
    for _ in range(_RELAXATIONS):
        relaxed = _relaxed(points, _delaunay(points), outline)[rim:free]
        points[rim:free] = _cleared(relaxed, outline, radius, held - rim)
    # Rounded: the triangulation must not depend on a processor's rounding of the sine.
    points[rim:] = points[rim:].round(9)
    return Mesh(rest=points, faces=_delaunay(points)), int(held)


def _circle(radius: float, count: int, rng: np.random.Generator) -> np.ndarray:
    """Equidistant points (N, 2) on a circle around the origin, with a random phase."""
    angle = 2 * np.pi * (np.arange(count) + rng.random()) / max(count, 1)
    return radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def _rings(outline: Outline, rng: np.random.Generator, radius: float, sign: int) -> np.ndarray:
    """Points (N, 2) on circles beyond ``radius``, outwards (``sign`` 1) or inwards (-1)."""
    reach = outline.rig.specimen_size / np.sqrt(2) + np.hypot(*outline.centre)

    def length(radius: float) -> float:
        return outline.edge_at(np.array([[max(radius, 0.0), 0.0]]))[0]

    rings = [np.empty((0, 2))]
    while True:
        step = sign * np.sqrt(0.75)
        radius += step * length(radius + step * length(radius) / 2)
        if not 0 <= radius <= reach:
            break
        edge = length(radius)
        ring = _circle(radius, max(1, round(2 * np.pi * radius / edge)), rng)
        rings.append(ring + rng.uniform(-_JITTER, _JITTER, ring.shape) * edge)
    points = np.concatenate(rings)
    clearance = _CLEARANCE * outline.edge_at(points)
    return points[outline.rig.to_border(points, outline.centre) > clearance]


def _border(outline: Outline, rng: np.random.Generator) -> np.ndarray:
    """Points (N, 2) on the border, spaced by the target edge length."""
    half, centre = outline.rig.specimen_size / 2, np.asarray(outline.centre)
    if outline.rig.specimen == "disc":
        fine = centre + _circle(half, 4000, rng)
        place = _spread(np.concatenate([fine, fine[:1]]), outline, rng)
        out = place - centre
        return centre + half * out / np.linalg.norm(out, axis=1, keepdims=True)
    corners = centre + half * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1], [-1, -1]])
    sides = (a + np.linspace(0, 1, 1000)[:, None] * (b - a)
             for a, b in pairwise(corners))
    return np.concatenate([_spread(side, outline, rng) for side in sides])


def _spread(curve: np.ndarray, outline: Outline, rng: np.random.Generator) -> np.ndarray:
    """Points (N, 2) along a finely sampled curve (K, 2), its start included, its end excluded."""
    length = np.linalg.norm(np.diff(curve, axis=0), axis=1)
    edges = np.append(0, np.cumsum(length / outline.edge_at(0.5 * (curve[1:] + curve[:-1]))))
    count = max(1, round(edges[-1]))
    place = np.arange(count) + np.append(0, rng.uniform(-_JITTER, _JITTER, count - 1) / 2)
    return np.stack([np.interp(place * edges[-1] / count, edges, curve[:, k]) for k in range(2)], 1)


def _delaunay(points: np.ndarray) -> np.ndarray:
    """Faces (F, 3), counter-clockwise, without degenerate ones along straight borders."""
    faces = Delaunay(points).simplices.astype(np.int64)
    twice = doubled_areas(points, faces)
    faces[twice < 0] = faces[twice < 0][:, [0, 2, 1]]
    return faces[np.abs(twice) > 1e-6 * np.median(np.abs(twice))]


def _relaxed(points: np.ndarray, faces: np.ndarray, outline: Outline) -> np.ndarray:
    """Means (V, 2) of the circumcentres around each point, weighted by the triangles' areas over
    the squared target edge length."""
    a, b, c = (points[faces[:, k]] for k in range(3))
    u, v = b - a, c - a
    twice = doubled_areas(points, faces)
    uu, vv = (u**2).sum(1)[:, None], (v**2).sum(1)[:, None]
    perpendicular = uu * np.stack([v[:, 1], -v[:, 0]], 1) + vv * np.stack([-u[:, 1], u[:, 0]], 1)
    centroid = (a + b + c) / 3
    # The circumcentre of an obtuse triangle is outside and must not move points there.
    away = a + perpendicular / (2 * twice[:, None]) - centroid
    limit = np.sqrt(twice / 2) / np.linalg.norm(away, axis=1).clip(1e-300)
    centres = centroid + away * np.minimum(1.0, limit)[:, None]
    weight, count = np.repeat(twice / outline.edge_at(centroid) ** 2, 3), len(points)
    total = np.bincount(faces.ravel(), weight, count)
    return np.stack([np.bincount(faces.ravel(), weight * np.repeat(centre, 3), count)
                     for centre in centres.T], axis=1) / total[:, None]


def _cleared(points: np.ndarray, outline: Outline, radius: float, inside: int) -> np.ndarray:
    """Points (N, 2), the first ``inside`` of them on the plate, moved away from the rim."""
    distance = np.linalg.norm(points, axis=1)
    clearance = _CLEARANCE * outline.edge
    target = np.append(np.minimum(distance[:inside], radius - clearance),
                       np.maximum(distance[inside:], radius + clearance))
    return points * (target / distance.clip(1e-300))[:, None]
