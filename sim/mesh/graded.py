"""Triangulations of squares and discs, fine at the plate's rim and coarser towards the hem.

Cloth is bent twice within some 25 mm of the rim; that is where meshes of one edge length fail.
Points lie on circles around the plate, as far apart as the wanted edges, at random on each circle.
A few rounds of relaxation (optimal Delaunay triangulation, Alliez et al. 2005, with the wanted
edge length as its size field) make the triangles nearly equilateral.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.spatial import Delaunay

from sim.mesh.topology import Mesh, doubled_areas
from sim.scene import Rig

GROWTH = 0.1
"""Growth of the edges' length with the distance from the rim."""
_GROWTH_HELD = 0.6  # the same on the plate, where triangles store no energy
_SHAKE = 0.3  # largest random move of a point before relaxation, in edges
_ROUNDS = 4
_CLEAR = 0.6
"""Least distance of a point from rim and border, in edges. Above one half, no point lies in the
circle over an edge of the rim, so that Delaunay's rule keeps that edge."""


@dataclass(frozen=True)
class Outline:
    """What a mesh covers and where it is fine.

    Attributes:
        rig: whose specimen, cut along its yarns; without a plate all edges have one length.
        centre: of the specimen, m from the plate's axis.
        edge: length of the edges at the rim, m.
        largest: length at most, m.
    """

    rig: Rig
    centre: tuple[float, float]
    edge: float
    largest: float

    def edge_at(self, points: np.ndarray) -> np.ndarray:
        """Wanted length (N,) of the edges at points (N, 2), m."""
        if not self.rig.has_plate:
            return np.full(len(points), self.edge)
        outside = np.linalg.norm(points, axis=1) - self.rig.plate_radius
        grown = np.minimum(self.edge + GROWTH * outside, self.largest)
        return np.where(outside < 0, self.edge - _GROWTH_HELD * outside, grown)


def rim_radius(outline: Outline) -> tuple[float, int]:
    """Radius, m, of the polygon that stands for the rim, and the number of its corners. It has the
    plate's area: with corners on the rim it would hold too little cloth."""
    corners = max(8, round(2 * np.pi * outline.rig.plate_radius / outline.edge))
    turn = 2 * np.pi / corners
    return outline.rig.plate_radius * np.sqrt(turn / np.sin(turn)), corners


def graded_mesh(outline: Outline, rng: np.random.Generator) -> tuple[Mesh, np.ndarray]:
    """The mesh of ``outline``, and how many of its vertices (V, 2) lie on the plate: the first
    ones, the rim's before the others."""
    radius, corners = rim_radius(outline) if outline.rig.has_plate else (0.0, 0)
    parts = [_circle(radius, corners, rng), _rings(outline, rng, radius, -1),
             _rings(outline, rng, radius, 1), _border(outline, rng)]
    rim, held, free, _ = np.cumsum([len(part) for part in parts])
    points = np.concatenate(parts)
    for _ in range(_ROUNDS):
        relaxed = _relaxed(points, _delaunay(points), outline)[rim:free]
        points[rim:free] = _kept_clear(relaxed, outline, radius, held - rim)
    # Rounded, so that the last bits of a processor's sine do not choose between triangulations.
    points[rim:] = points[rim:].round(9)
    return Mesh(rest=points, faces=_delaunay(points)), int(held)


def _circle(radius: float, count: int, rng: np.random.Generator) -> np.ndarray:
    """Points (N, 2) at equal distances on a circle around the origin, from a random one on."""
    angle = 2 * np.pi * (np.arange(count) + rng.random()) / max(count, 1)
    return radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def _rings(outline: Outline, rng: np.random.Generator, radius: float, way: int) -> np.ndarray:
    """Points (N, 2) on circles from ``radius`` on, outwards (``way`` 1) or inwards (-1)."""
    reach = outline.rig.specimen_size / np.sqrt(2) + np.hypot(*outline.centre)

    def length(radius: float) -> float:
        return outline.edge_at(np.array([[max(radius, 0.0), 0.0]]))[0]

    rings = [np.empty((0, 2))]
    while True:
        step = way * np.sqrt(0.75)
        radius += step * length(radius + step * length(radius) / 2)
        if not 0 <= radius <= reach:
            break
        edge = length(radius)
        ring = _circle(radius, max(1, round(2 * np.pi * radius / edge)), rng)
        rings.append(ring + rng.uniform(-_SHAKE, _SHAKE, ring.shape) * edge)
    points = np.concatenate(rings)
    return points[outline.rig.to_border(points, outline.centre) > _CLEAR * outline.edge_at(points)]


def _border(outline: Outline, rng: np.random.Generator) -> np.ndarray:
    """Points (N, 2) on the border, as far apart as the wanted edges there."""
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
    """Points (N, 2) along a finely sampled curve (K, 2) from its start on, its end left out."""
    length = np.linalg.norm(np.diff(curve, axis=0), axis=1)
    edges = np.append(0, np.cumsum(length / outline.edge_at(0.5 * (curve[1:] + curve[:-1]))))
    count = max(1, round(edges[-1]))
    place = np.arange(count) + np.append(0, rng.uniform(-_SHAKE, _SHAKE, count - 1) / 2)
    return np.stack([np.interp(place * edges[-1] / count, edges, curve[:, k]) for k in range(2)], 1)


def _delaunay(points: np.ndarray) -> np.ndarray:
    """Faces (F, 3), counter-clockwise, without the flat ones along straight borders."""
    faces = Delaunay(points).simplices.astype(np.int64)
    twice = doubled_areas(points, faces)
    faces[twice < 0] = faces[twice < 0][:, [0, 2, 1]]
    return faces[np.abs(twice) > 1e-6 * np.median(np.abs(twice))]


def _relaxed(points: np.ndarray, faces: np.ndarray, outline: Outline) -> np.ndarray:
    """Each point (V, 2) at the mean of the circumcentres around it, weighted by the triangles'
    areas in units of the wanted edge length."""
    a, b, c = (points[faces[:, k]] for k in range(3))
    u, v = b - a, c - a
    twice = doubled_areas(points, faces)
    uu, vv = (u**2).sum(1)[:, None], (v**2).sum(1)[:, None]
    perpendicular = uu * np.stack([v[:, 1], -v[:, 0]], 1) + vv * np.stack([-u[:, 1], u[:, 0]], 1)
    centroid = (a + b + c) / 3
    # The circumcentre of an obtuse triangle lies outside; it must not pull points out with it.
    away = a + perpendicular / (2 * twice[:, None]) - centroid
    limit = np.sqrt(twice / 2) / np.linalg.norm(away, axis=1).clip(1e-300)
    centres = centroid + away * np.minimum(1.0, limit)[:, None]
    weight, count = np.repeat(twice / outline.edge_at(centroid) ** 2, 3), len(points)
    total = np.bincount(faces.ravel(), weight, count)
    return np.stack([np.bincount(faces.ravel(), weight * np.repeat(centre, 3), count)
                     for centre in centres.T], axis=1) / total[:, None]


def _kept_clear(points: np.ndarray, outline: Outline, radius: float, inside: int) -> np.ndarray:
    """Points (N, 2), the first ``inside`` of them on the plate, moved clear of the rim."""
    distance = np.linalg.norm(points, axis=1)
    clear = _CLEAR * outline.edge
    wanted = np.append(np.minimum(distance[:inside], radius - clear),
                       np.maximum(distance[inside:], radius + clear))
    return points * (wanted / distance.clip(1e-300))[:, None]
