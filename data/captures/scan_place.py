"""Where the plate is in a scan of anything: its unit, its plane, its centre, and what is not cloth.

The flat part of a drape lies on the plate. Planes are searched for in the scan (RANSAC), largest
first, and read in each unit of :data:`UNITS`. The plate's is one whose flat part has the size of
the plate and from whose rim cloth hangs all around.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import Delaunay, cKDTree

from common.errors import InputError
from common.findings import Finding
from common.types import Faces, Metres, Points, Vector
from data.captures.plane_fit import largest_plane
from sim.rig import Rig

UNITS = {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "inches": 0.0254, "feet": 0.3048, "µm": 1e-6}
MAX_TILT = 10.0  # degrees, of the plate against the nearest axis
MAX_OFFSET = 5e-3  # m, of a plate's centre; the measured centre is 1 mm off, at most 6 mm
MIN_FALL = 5e-3  # m, of the lowest cloth below the plate
_MIN_TILT, _MIN_LIFT = 0.25, 0.5e-3  # degrees, m: less is left as it is
_MAX_EXTENT = 10.0  # m, of a scan with all that is around the tester
_SAMPLED, _SEARCHED = 100_000, 10_000  # points of a surface; of these, where planes are sought
_PLANES, _TRIALS = 6, 2000  # sought one after the other; draws of three points for each
_FLAT = 1.5e-3  # m, between the heights of points on the plate
_PLATE_RATIO = 0.85, 1.6  # of the flat part's radius over the plate's
_INNER = 0.95  # of the plate's radius, within which all cloth is on it
_REFITS = 12
_SURE = 0.9  # of the points within the specimen's reach: no other plane is the plate's
_RIM = 1.03  # of the plate's radius, within which cloth shows the plate's height
_SECTORS, _MIN_HELD, _MIN_HANGING = 36, 1 / 2, 1 / 3
"""Of azimuth; shares of them in which cloth is on the plate or its rim, and hangs."""
_MAX_RAISED = 0.2  # points above the plate, over those within the specimen's reach
_MIN_REACH = 0.7  # of the overhang, the distance of the hem from the plate
_MAX_BEYOND = 0.1  # of the points connected with the plate, beyond the specimen's reach
_SLACK = 0.05, 5e-3  # of the overhang, and m: cloth is sought that far beyond it
_COLUMN = 2 / 3, 10e-3  # of the plate's radius and m: no cloth is as near the axis and as low
_TABLE_TILT, _TABLE_DEPTH = 5.0, 4e-3  # degrees against the plate; m, half the surface's thickness
_MIN_TABLE = 0.3  # of the points beyond the specimen's reach
_GAP, _SPACINGS = 8e-3, 4.0  # m, or distances between points: wider gaps are gaps in the surface
_CELL = 5e-3  # m, between points that are put on the plate
_MAX_UNSEEN = 0.05  # of the plate's area
_UPRIGHT = {up: cv2.Rodrigues(np.pi / 2 * np.array(turn))[0].round() for up, turn in {
    "z": (0.0, 0, 0), "y": (1.0, 0, 0), "x": (0, -1.0, 0), "-z": (2.0, 0, 0), "-y": (-1.0, 0, 0),
    "-x": (0, 1.0, 0)}.items()}
"""Turns that make axes point up, by axis; quarter turns about x or y."""


@dataclass(frozen=True)
class ScannedPlate:
    """The plate in a scan of which a unit has ``metres``: normal, pointing up, and centre, m."""

    unit: str
    normal: Vector
    centre: Vector

    @property
    def up(self) -> str:
        """The axis that is nearest to the vertical."""
        return max(_UPRIGHT, key=lambda name: (_UPRIGHT[name] @ self.normal)[2])

    @property
    def tilt(self) -> float:
        """Angle, degrees, between the vertical and that axis."""
        return math.degrees(math.acos(min((_UPRIGHT[self.up] @ self.normal)[2], 1.0)))

    def placed(self, points: Points) -> tuple[Points, list[Finding]]:
        """Points in units of the scan in metres, z up, the plate's centre the origin, and what that
        changed; InputError for a plate that is too far off level."""
        if self.tilt > MAX_TILT:
            raise InputError(
                f"no level plate was found; what is most like it is tilted by {self.tilt:.0f}° "
                f"against the axis {self.up}, at most {MAX_TILT:g}° is levelled: turn the scan "
                "until the plate is level, and cut away all that is not cloth")
        turn = _UPRIGHT[self.up]
        changes = [Finding("scan_unit", {"unit": self.unit})] * (self.unit != "m")
        changes += [Finding("scan_axis", {"axis": self.up})] * (self.up != "z")
        if self.tilt > _MIN_TILT:
            changes.append(Finding("scan_tilted", {"value": self.tilt}))
            turn = _shortest_turn(turn @ self.normal) @ turn
        centre = turn @ self.centre
        centre[:2] *= np.linalg.norm(centre[:2]) > MAX_OFFSET
        centre[2] *= abs(centre[2]) > _MIN_LIFT
        if (off := float(np.linalg.norm(centre))) > 0:
            changes.append(Finding("scan_off_origin", {
                "value": round(1e3 * off, 1 if off < MAX_OFFSET else None)}))
        return UNITS[self.unit] * points @ turn.T - centre, changes


def _shortest_turn(normal: Vector) -> np.ndarray:
    """Rotation (3, 3) that turns a normal to the z axis."""
    axis = np.cross(normal, [0.0, 0.0, 1.0])
    return cv2.Rodrigues(axis / np.linalg.norm(axis) * math.acos(normal[2]))[0]


def plate_of_scan(points: Points, faces: Faces, rig: Rig) -> ScannedPlate:
    """The plate in a scan in any unit and orientation; InputError if there is none."""
    cloud = _surface_points(points, faces)
    extent = np.ptp(cloud, axis=0).max()
    best, most = None, 0.0
    # A drape alone shows its unit: that in which it is as large as the specimen.
    for unit, metres in sorted(UNITS.items(), key=lambda item: abs(
            math.log(item[1] * extent / rig.specimen_size)) if extent else 0.0):
        if not 0.9 * rig.plate_diameter < metres * extent < _MAX_EXTENT:
            continue
        for plane in _planes(metres * cloud):
            normal, centre, share = _plate_in(metres * cloud, *plane, rig)
            if share > most:
                best, most = ScannedPlate(unit, normal, centre), share
            if most > _SURE and best:
                return best
    if best:
        return best
    raise InputError(
        f"no plate of {1e3 * rig.plate_diameter:g} mm with cloth hanging {1e3 * MIN_FALL:g} mm or "
        f"more below it was found, with lengths in any of {', '.join(UNITS)} (the scan is "
        f"{extent:.4g} of its units wide); give a scan of a specimen of {rig.name}, with the flat "
        "cloth on the plate, at least around its rim")


def _surface_points(points: Points, faces: Faces) -> np.ndarray:
    """At most :data:`_SAMPLED` points (M, 3) of a scan; those of a mesh are spread evenly over it.
    """
    import trimesh

    if len(faces):
        mesh = trimesh.Trimesh(points, faces, process=False)
        return trimesh.sample.sample_surface(mesh, _SAMPLED, seed=0)[0]
    return _some(points, _SAMPLED)


def _some(points: np.ndarray, most: int) -> np.ndarray:
    """``most`` of the rows (N, ...), chosen at random, the same each time."""
    if len(points) <= most:
        return points
    return points[np.random.default_rng(0).choice(len(points), most, replace=False)]


def _planes(cloud: Points) -> Iterator[tuple[Vector, float]]:
    """Normal n and height h, m, of planes n·x = h with many points, each without those before."""
    rng, rest = np.random.default_rng(0), cloud
    for _ in range(_PLANES):
        some = _some(rest, _SEARCHED)
        if len(some) < _SECTORS:
            return
        normal, shift = largest_plane(some, _FLAT, draws=_TRIALS, rng=rng)
        yield normal, -shift
        rest = rest[np.abs(rest @ normal + shift) > 2 * _FLAT]


def _plate_in(
    cloud: Points, normal: Vector, height: float, rig: Rig
) -> tuple[Vector, Vector, float]:
    """Normal and centre of the plate in a plane, and the share of points that are within reach of
    the specimen on it; 0 if it is not like a plate."""
    none = normal, normal, 0.0
    slab = cloud[np.abs(cloud @ normal - height) < 0.2 * rig.plate_radius]
    for refit in range(_REFITS):
        above = slab @ normal - height
        flat = slab[np.abs(above) < _FLAT]
        if len(flat) < _SECTORS:
            return none
        centre, radius = _flat_part(flat, normal, height, rig)
        if not _PLATE_RATIO[0] < radius / rig.plate_radius < _PLATE_RATIO[1]:
            return none
        # Stiff cloth is nearly flat beyond the rim, too: the plane is that of its middle alone.
        tolerance = max(_FLAT, 4e-3 / (1 + refit))
        held = slab[(np.abs(above) < tolerance)
                    & (_across(slab - centre, normal) < _INNER * rig.plate_radius)]
        if len(held) < _SECTORS:
            held = _innermost(flat, centre, normal)
        middle = held.mean(axis=0)
        fitted = np.linalg.svd(held - middle, full_matrices=False)[2][2]
        normal = fitted if fitted @ normal > 0 else -fitted
        height = float(normal @ middle)
    above, across = cloud @ normal - height, _across(cloud - centre, normal)
    distance = np.hypot(np.maximum(across - rig.plate_radius, 0), above)
    near = distance < _far(rig)
    if above[near].mean() > 0:
        normal, height, above = -normal, -height, -above
    raised = (above > 2 * _FLAT) & (across < rig.reach)
    if (raised.sum() > _MAX_RAISED * near.sum()
            or distance[near].max() < _MIN_REACH * rig.overhang):
        return none
    held = (np.abs(above) < 2 * _FLAT) & (across < _RIM * rig.plate_radius)
    hanging = near & (above < -0.8 * MIN_FALL) & (across > _COLUMN[0] * rig.plate_radius)
    for part, share in ((held, _MIN_HELD), (hanging, _MIN_HANGING)):
        sectors = _sectors((cloud[part] - centre) @ _axes(normal).T)
        if len(np.unique(sectors)) < share * _SECTORS:
            return none
    return normal, centre + (height - centre @ normal) * normal, float(near.mean())


def _far(rig: Rig) -> Metres:
    """Distance from the plate beyond which no cloth is."""
    return (1 + _SLACK[0]) * rig.overhang + _SLACK[1]


def _axes(normal: Vector) -> np.ndarray:
    """Two directions (2, 3) along a plane, at right angles."""
    return np.linalg.svd(normal[None])[2][1:]


def _across(offsets: Points, normal: Vector) -> np.ndarray:
    """Distances (N,), m, from the axis along ``normal``."""
    return np.linalg.norm(offsets - (offsets @ normal)[:, None] * normal, axis=1)


def _flat_part(flat: Points, normal: Vector, height: float, rig: Rig) -> tuple[Vector, Metres]:
    """Centre and radius of the flat part, of its hull: points may be denser at one side."""
    axes = _axes(normal)
    seen = flat @ axes.T
    middle = np.median(seen, axis=0)
    for _ in range(2):  # of what lies in the same plane far away, nothing counts
        near = np.linalg.norm(seen - middle, axis=1) < 1.1 * _PLATE_RATIO[1] * rig.plate_radius
        hull = cv2.moments(cv2.convexHull(seen[near].astype(np.float32)))
        if not hull["m00"] > 0:
            return middle @ axes + height * normal, 0.0
        middle = np.array([hull["m10"], hull["m01"]]) / hull["m00"]
    return middle @ axes + height * normal, math.sqrt(hull["m00"] / np.pi)


def _innermost(flat: Points, centre: Vector, normal: Vector) -> np.ndarray:
    """The points (M, 3), m, of the flat part that are nearest to the axis, of each sector."""
    seen = (flat - centre) @ _axes(normal).T
    sector = _sectors(seen)
    order = np.lexsort([np.linalg.norm(seen, axis=1), sector])
    return flat[order[np.unique(sector[order], return_index=True)[1]]]


def _sectors(seen: np.ndarray) -> np.ndarray:
    """Sectors of azimuth (N,) of points (N, 2) along the plate, m, from its centre."""
    return np.floor(_SECTORS * np.arctan2(seen[:, 1], seen[:, 0]) / (2 * np.pi)).astype(int)


def _unseen(seen: np.ndarray, rig: Rig) -> np.ndarray:
    """Places (M, 2), m, on the plate, :data:`_CELL` apart, in the gaps of points (N, 2) on it."""
    side = np.arange(-rig.plate_radius, rig.plate_radius, _CELL) + _CELL / 2
    places = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    places = places[np.linalg.norm(places, axis=1) < _INNER * rig.plate_radius]
    if not len(seen):
        return places
    return places[cKDTree(seen).query(places)[0] > _gap(seen)]


def _gap(points: np.ndarray) -> Metres:
    """Distance that separates pieces of a surface through points (N, D), m."""
    some = _some(points, _SEARCHED)
    spacing = np.median(cKDTree(points).query(some, 2)[0][:, 1]) if len(points) > 1 else 0.0
    return max(_GAP, _SPACINGS * float(spacing))


def cut_away(points: Points, faces: Faces, rig: Rig) -> tuple[np.ndarray, list[Finding]]:
    """Which points (N,) bool of a placed scan are cloth, and what the others are; InputError if
    much that is connected with the plate lies where no cloth of ``rig`` can be.

    What is not connected with the plate and not within the specimen's reach, the table below, and
    the column are not cloth.
    """
    radius, height = np.hypot(points[:, 0], points[:, 1]), points[:, 2]
    beyond = np.hypot(np.maximum(radius - rig.plate_radius, 0), height) > _far(rig)
    table, depth = _table(points, beyond & (radius > rig.reach))
    column = (radius < _COLUMN[0] * rig.plate_radius) & (height < -_COLUMN[1])
    keep = ~table & ~column
    if (beyond & keep).any():
        piece = _pieces(points, faces, keep)
        home = np.bincount(piece[keep & (radius < rig.plate_radius) & (np.abs(height) < 2 * _FLAT)]
                           ).argmax()
        apart = keep & (piece != home) & np.isin(piece, piece[beyond & keep])
        keep &= ~apart
    if (share := float((beyond & keep).sum() / keep.sum())) > _MAX_BEYOND:
        raise InputError(
            f"{share:.0%} of its points do not lie on a specimen of {rig.name}, but are connected "
            "with the cloth; cut away all that is not cloth, such as the table, or drape a "
            "specimen of that size")
    others = [("scan_table", table, {"depth": 1e3 * float(depth)}),
              ("scan_pieces", ~(keep | table), {})]
    return keep, [Finding(code, {"value": int(part.sum()), "points": len(points)} | values)
                  for code, part, values in others if part.any()]


def _table(points: Points, beyond: np.ndarray) -> tuple[np.ndarray, Metres]:
    """Which points (N,) bool lie on or below a level plane that most of those ``beyond`` the
    specimen's reach are on, and its depth, m, below the plate."""
    none = np.zeros(len(points), dtype=bool), 0.0
    if beyond.sum() < _SECTORS:
        return none
    normal, height = next(_planes(points[beyond]))
    normal, height = (normal, height) if normal[2] > 0 else (-normal, -height)
    above = points @ normal - height
    level = normal[2] > math.cos(math.radians(_TABLE_TILT))
    if not level or height > 0 or (np.abs(above[beyond]) < _TABLE_DEPTH).mean() < _MIN_TABLE:
        return none
    return above < _TABLE_DEPTH, -height / normal[2]


def _pieces(points: Points, faces: Faces, keep: np.ndarray) -> np.ndarray:
    """A number (N,) for each piece of a surface without what is not kept, the same for its points.
    """
    if len(faces):
        edges = faces[keep[faces].all(axis=1)][:, [0, 1, 1, 2]].reshape(-1, 2).T
        graph = coo_array((np.ones(edges.shape[1]), edges), shape=(len(points),) * 2)
        return connected_components(graph, directed=False)[1]
    cell = np.floor((points - points.min(axis=0)) / _gap(points[keep])).astype(int)
    cells, of = np.unique(cell, axis=0, return_inverse=True)
    kept = np.zeros(len(cells), dtype=bool)
    kept[of[keep]] = True
    near = np.array(sorted(cKDTree(cells[kept]).query_pairs(1.8))).reshape(-1, 2).T
    places = np.flatnonzero(kept)
    graph = coo_array((np.ones(near.shape[1]), places[near]), shape=(len(cells),) * 2)
    return connected_components(graph, directed=False)[1][of.ravel()]


def plate_filled(
    points: Points, faces: Faces, rig: Rig
) -> tuple[np.ndarray, np.ndarray, list[Finding]]:
    """Points (M, 3), m, and faces (G, 3) of a placed scan with points of the plate's plane where it
    has none on the plate, and a warning."""
    cloud = _surface_points(points, faces)
    on_plate = cloud[np.abs(cloud[:, 2]) < 2 * _FLAT]
    places = _unseen(on_plate[:, :2], rig)
    area = len(_unseen(on_plate[:0, :2], rig))
    if len(places) < _MAX_UNSEEN * area:
        return points, faces, []
    if len(faces):
        corners = Delaunay(places).simplices
        longest = np.linalg.norm(places[corners] - places[np.roll(corners, 1, axis=1)], axis=2)
        faces = np.concatenate([faces, len(points) + corners[longest.max(axis=1) < 1.5 * _CELL]])
    points = np.concatenate([points, np.column_stack([places, np.zeros(len(places))])])
    return points, faces, [Finding("scan_plate_unseen", {"value": len(places) / area})]
