"""Meshes of a rig's specimen, a rectangle or disc: fine at the plate's rim, coarser at the hem.

Initial points are on circles around the plate, spaced by the target edge length, with a random
phase. A few rounds of relaxation (optimal Delaunay triangulation, Alliez et al. 2005, with the
target edge length as size field) make the triangles nearly equilateral.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

import numpy as np

from common.errors import InputError
from common.types import Faces, Metres, RestPoints, VertexMask
from sim.material import Fabric, gravity_length
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
class Domain:
    """Domain and edge lengths of a graded mesh; without a plate the mesh is uniform."""

    rig: Rig  # cut along the yarns
    centre: tuple[float, float]  # of the specimen, m from the plate's axis
    edge: Metres  # at the rim
    largest: Metres

    def edge_at(self, points: RestPoints) -> np.ndarray:
        """Target edge lengths (N,), m."""
        if not self.rig.has_plate:
            return np.full(len(points), self.edge)
        outside = np.linalg.norm(points, axis=1) - self.rig.plate_radius
        grown = np.minimum(self.edge + GROWTH * outside, self.largest)
        return np.where(outside < 0, self.edge - _GROWTH_HELD * outside, grown)


def graded_mesh(domain: Domain, rng: np.random.Generator) -> tuple[Mesh, int]:
    """The mesh of ``domain`` and the number of vertices on the plate: they are the first of the
    vertices (V, 2), those of the rim before the others."""
    radius, corners = domain.rig.plate_radius, 0
    if domain.rig.has_plate:
        # A polygon of the plate's area: an inscribed one would hold too little cloth.
        corners = max(8, round(2 * np.pi * radius / domain.edge))
        turn = 2 * np.pi / corners
        radius *= np.sqrt(turn / np.sin(turn))
    parts = [_circle(radius, corners, rng), _rings(domain, rng, radius, -1),
             _rings(domain, rng, radius, 1), _border(domain, rng)]
    rim, held, free, _ = np.cumsum([len(part) for part in parts])
    points = np.concatenate(parts)
    for _ in range(_RELAXATIONS):
        relaxed = _relaxed(points, _delaunay(points), domain)[rim:free]
        points[rim:free] = _cleared(relaxed, domain, radius, held - rim)
    # Rounded: the triangulation must not depend on a processor's rounding of the sine.
    points[rim:] = points[rim:].round(9)
    return Mesh(rest=points, faces=_delaunay(points)), int(held)


def _circle(radius: float, count: int, rng: np.random.Generator) -> np.ndarray:
    """Equidistant points (N, 2) on a circle around the origin, with a random phase."""
    angle = 2 * np.pi * (np.arange(count) + rng.random()) / max(count, 1)
    return radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def _rings(domain: Domain, rng: np.random.Generator, radius: float, sign: int) -> np.ndarray:
    """Points (N, 2) on circles beyond ``radius``, outwards (``sign`` 1) or inwards (-1)."""
    reach = np.hypot(*domain.rig.sides) / 2 + np.hypot(*domain.centre)

    def length(radius: float) -> float:
        return domain.edge_at(np.array([[max(radius, 0.0), 0.0]]))[0]

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
    clearance = _CLEARANCE * domain.edge_at(points)
    return points[domain.rig.to_border(points, domain.centre) > clearance]


def _border(domain: Domain, rng: np.random.Generator) -> np.ndarray:
    """Points (N, 2) on the border, spaced by the target edge length."""
    half, centre = np.array(domain.rig.sides) / 2, np.asarray(domain.centre)
    if domain.rig.specimen == "disc":
        fine = centre + _circle(half[0], 4000, rng)
        place = _spread(np.concatenate([fine, fine[:1]]), domain, rng)
        out = place - centre
        return centre + half * out / np.linalg.norm(out, axis=1, keepdims=True)
    corners = centre + half * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1], [-1, -1]])
    sides = (a + np.linspace(0, 1, 1000)[:, None] * (b - a) for a, b in pairwise(corners))
    return np.concatenate([_spread(side, domain, rng) for side in sides])


def _spread(curve: np.ndarray, domain: Domain, rng: np.random.Generator) -> np.ndarray:
    """Points (N, 2) along a finely sampled curve (K, 2), its start included, its end excluded."""
    length = np.linalg.norm(np.diff(curve, axis=0), axis=1)
    edges = np.append(0, np.cumsum(length / domain.edge_at(0.5 * (curve[1:] + curve[:-1]))))
    count = max(1, round(edges[-1]))
    place = np.arange(count) + np.append(0, rng.uniform(-_JITTER, _JITTER, count - 1) / 2)
    return np.stack([np.interp(place * edges[-1] / count, edges, curve[:, k]) for k in range(2)], 1)


def _delaunay(points: RestPoints) -> Faces:
    """Triangles, counter-clockwise, without degenerate ones along straight borders."""
    from scipy.spatial import Delaunay  # who checks an edge does not wait for it

    faces = Delaunay(points).simplices.astype(np.int64)
    twice = doubled_areas(points, faces)
    faces[twice < 0] = faces[twice < 0][:, [0, 2, 1]]
    return faces[np.abs(twice) > 1e-6 * np.median(np.abs(twice))]


def _relaxed(points: np.ndarray, faces: np.ndarray, domain: Domain) -> np.ndarray:
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
    weight, count = np.repeat(twice / domain.edge_at(centroid) ** 2, 3), len(points)
    total = np.bincount(faces.ravel(), weight, count)
    return np.stack([np.bincount(faces.ravel(), weight * np.repeat(centre, 3), count)
                     for centre in centres.T], axis=1) / total[:, None]


def _cleared(points: np.ndarray, domain: Domain, radius: float, inside: int) -> np.ndarray:
    """Points (N, 2), the first ``inside`` of them on the plate, moved away from the rim."""
    distance = np.linalg.norm(points, axis=1)
    clearance = _CLEARANCE * domain.edge
    target = np.append(np.minimum(distance[:inside], radius - clearance),
                       np.maximum(distance[inside:], radius + clearance))
    return points * (target / distance.clip(1e-300))[:, None]


TOPOLOGIES = 8
"""Number of random triangulations of one size; drapes share them."""
GRADING = 4.0
"""Edge length at the hem over edge length at the rim."""
MAX_EDGE = 0.020
"""Maximum edge length, m, so that coarse meshes resolve the folds of a start."""
DEFAULT_EDGES = (2e-3, 2.5e-3, 3e-3, 4e-3, 5e-3, 6e-3)  # m, see :func:`default_edge`
EDGES_PER_LENGTH = 5
_REFINEMENT = 2.5  # ratio of edge lengths of successive meshes of a drape
MAX_COARSE_EDGE = 0.013
"""Maximum edge length at the rim, m, of the first mesh of a drape."""
MAX_BORROWED_EDGE = 0.008
"""The same for a warm start from another drape, whose folds must be resolved."""
EDGE_RANGE = (5e-4, 5e-2)
"""Edge lengths at the rim, m; limited by memory and time, and by the shape of the plate."""
MAX_SHARED_OFFSET = 0.2
"""Maximum offset, in widths of the overhang, for which a base mesh is deformed; triangles on the
narrow side lose that share of their width."""
_MIN_EDGES_ACROSS = 2.0  # between rim and border
_SIZE_STEP = 5e-3  # m; sizes of base meshes are multiples of it
_MAX_SCALING = 0.03  # maximum relative change of a base mesh's size, or of its plate's


def mesh_specimen(
    rig: Rig, *, edge: Metres, topology: int = 0, offset: tuple[float, float] = (0.0, 0.0),
    grading: float = GRADING
) -> tuple[Mesh, VertexMask]:
    """The mesh of the specimen of ``rig`` and the vertices that the rig holds. The origin of the
    rest points is on the plate's axis, without a plate at the specimen's centre.

    Specimens of similar size and offset share the faces of a base mesh: points on the plate move
    with the plate, those on the border with the border, others in proportion.

    Args:
        edge: edge length at the plate's rim, within :data:`EDGE_RANGE`. Without a plate, of all
            edges.
        topology: index of one of the :data:`TOPOLOGIES` random triangulations.
        offset: specimen's centre from the plate's axis, m.
        grading: edge length at the hem over ``edge``, at least 1. Lengths grow by 10 % per edge, up
            to :data:`MAX_EDGE`; on the plate, where triangles store no energy, they grow faster.
    """
    rig = rig.sharp
    _check(rig, edge, offset)
    # In the axes of the sides, which may differ from warp and weft.
    along_sides = np.asarray(offset, dtype=float) @ rig.directions
    shared = np.hypot(*along_sides) <= MAX_SHARED_OFFSET * rig.least_overhang
    base = _base_rig(rig)
    mesh, held = base_mesh(base, float(edge), int(topology),
                           (0.0, 0.0) if shared else tuple(along_sides.tolist()), float(grading))
    if rig == base and not (shared and along_sides.any()):
        return mesh, held
    rest = mesh.rest
    share = share_of_offset(rest, base, (0, 0) if shared else along_sides)
    share = np.where(held, 0.0, share)
    if rig.has_plate:
        plate = rig.plate_diameter / base.plate_diameter
        border = np.array(rig.sides) / base.sides
        rest = rest * (plate + (border - plate) * share[:, None])
    if shared:
        rest = rest + share[:, None] * along_sides
    return mesh.with_rest(rest @ rig.directions.T), held


def _base_rig(rig: Rig) -> Rig:
    """The rig whose meshes are used for ``rig``: of rounded sizes, cut along the yarns."""
    if not rig.has_plate:
        return rig
    sizes = np.array([*rig.sides, rig.plate_diameter])
    rounded = np.round(_SIZE_STEP * np.round(sizes / _SIZE_STEP), 6)
    near = (np.abs(rounded - sizes) <= _MAX_SCALING * sizes).all()
    *sides, plate = (rounded if near else sizes).tolist()
    return Rig(tuple(sides), plate, rig.specimen)


def _check(rig: Rig, edge: Metres, offset: tuple[float, float]) -> None:
    check_edge(edge)
    if not rig.has_plate and np.any(offset):
        raise InputError(f"rig {rig.name} has no plate for an offset to refer to")
    longest = longest_edge(rig, offset)
    if not edge <= longest:
        raise InputError(f"an overhang of {1e3 * _MIN_EDGES_ACROSS * longest:.3g} mm at its "
                         f"narrowest is too narrow for edges of {1e3 * edge:.3g} mm, which need "
                         f"{1e3 * _MIN_EDGES_ACROSS * edge:.3g} mm; reduce the offset or refine")


def longest_edge(rig: Rig, offset: tuple[float, float]) -> Metres:
    """Maximum edge length at the rim for the narrowest overhang of a specimen; InputError for an
    ``offset`` that uncovers the plate."""
    if not rig.has_plate:
        return np.inf
    shifts = np.abs(np.asarray(offset) @ rig.directions)
    if rig.specimen == "disc":
        shifts = np.full(2, np.hypot(*offset))
    overhangs = (np.array(rig.sides) - rig.sharp.plate_diameter) / 2
    narrowest = np.argmin(overhangs - shifts)
    overhang, shift = overhangs[narrowest], shifts[narrowest]
    if shift >= overhang:
        raise InputError(f"an offset of {1e3 * shift:.3g} mm uncovers the plate of {rig.name}; at "
                         f"most {1e3 * overhang:.3g} mm is possible; give it in metres")
    return (overhang - shift) / _MIN_EDGES_ACROSS


def check_edge(edge: Metres) -> None:
    """InputError for an edge length at the rim outside :data:`EDGE_RANGE`."""
    least, most = EDGE_RANGE
    if not least <= edge <= most:
        raise InputError(f"edge={1e3 * edge:g} mm at the rim must lie between {1e3 * least:g} and "
                         f"{1e3 * most:g} mm")


@lru_cache(maxsize=128)
def base_mesh(
    rig: Rig, edge: Metres, topology: int, centre: tuple[float, float], grading: float
) -> tuple[Mesh, VertexMask]:
    """The mesh of a specimen around ``centre``, triangulated for that offset."""
    largest = max(edge, min(grading * edge, MAX_EDGE))
    mesh, count = graded_mesh(Domain(rig, centre, edge, largest), np.random.default_rng(topology))
    if rig.has_plate:
        return mesh, np.arange(len(mesh.rest)) < count
    corners = np.array([[-0.5, 0.5], [0.5, 0.5]]) * rig.sides
    return mesh, (mesh.rest[:, None] == corners).all(axis=2).any(axis=1)


def share_of_offset(
    rest: RestPoints, rig: Rig, centre: np.ndarray | tuple[float, float] = (0.0, 0.0)
) -> np.ndarray:
    """Share (V,) of a change of offset by which points of a specimen around ``centre`` move: zero
    on the plate, one on the border, proportional between them."""
    to_plate, to_border = rig.to_plate(rest), np.maximum(rig.to_border(rest, centre), 0.0)
    return to_plate / np.maximum(to_plate + to_border, 1e-12)


def default_edge(
    fabric: Fabric, rig: Rig, edges: Sequence[Metres] = DEFAULT_EDGES,
    offset: tuple[float, float] = (0.0, 0.0)
) -> Metres:
    """Default edge length at the rim for a fabric: the largest of few ``edges``, so that drapes
    share meshes, of which :data:`EDGES_PER_LENGTH` fit into the gravity length and two into the
    narrowest overhang. Without a plate, that of the hem."""
    length = gravity_length(fabric.alpha.min(), fabric.density)
    longest = longest_edge(rig, offset)
    fits = [edge for edge in edges if edge <= min(length / EDGES_PER_LENGTH, longest)]
    edge = max(fits, default=min(*edges, longest))
    return edge if rig.has_plate else GRADING * edge


def coarse_to_fine(edge: Metres, coarsest: Metres = MAX_COARSE_EDGE) -> list[Metres]:
    """Edge lengths at the rim of a drape's meshes, each 2.5 times shorter than the previous; all
    but the last are at most ``coarsest``."""
    check_edge(edge)
    levels = [edge]
    while _REFINEMENT * levels[0] <= coarsest:
        levels.insert(0, _REFINEMENT * levels[0])
    return levels
