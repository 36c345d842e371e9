"""Objective: the outline of a drape seen from above, compared with the simulated one by azimuth.

A residual is the difference of two radii. Where the simulated outline's segment with the normal n
crosses the ray e, a move v of the crossing changes the radius by n·v / n·e.
"""

import math
from dataclasses import dataclass

import numpy as np

from common.types import Edges, Metres, Points, Radians, RestPoints
from drapenet.refine.objective import Linearised, Moves, Nuisance, Residuals, huber
from drapenet.refine.placement import arc_lengths, positions_along
from drapenet.refine.springs import REACH, Springs, springs_to
from drapenet.views.directions import AZIMUTH, AZIMUTHS
from drapenet.views.outline import DrapeOutline
from sim.measures import crossings
from sim.rig import Rig
from sim.scene import Scene

NUISANCES = ("turn", "picture_x", "picture_y", "scale", "perspective")
"""Direction of the warp in the outline, rad, place of the plate's centre in the picture, m,
logarithm of the picture's scale, and 1/m, inverse height of the camera."""
_SCALE = np.array([0.02, 1e-3, 1e-3, 5e-3, 0.2])
TURN_DEVIATION = math.radians(2.0)  # of the warp as stated
PICTURE_DEVIATION, SCALE_DEVIATION = 1.5e-3, 0.007  # m, relative
HEIGHT_DEVIATION = 0.03  # relative, of a stated height
UNKNOWN_PERSPECTIVE = (1.0, 0.6)  # 1/m, mean and standard deviation: 0.6 m and more
_BEND = 0.03  # m, over which cloth laid on an outline bends down behind the rim
_STEEPEST = 0.75 * math.pi
_ROUNDS = 40  # of the bisection


@dataclass(frozen=True)
class OutlineWeights:
    """Noise model: standard deviation of a radius, with the model's error; from where the cost is
    linear; and azimuths whose errors count as one measurement."""

    sigma: Metres = 1e-3
    limit: Metres = 4e-3
    patch: float = 4.0


@dataclass(frozen=True)
class _Crossings:
    """Where the rays of N azimuths cross the simulated outline."""

    rows: np.ndarray  # (N,) of the azimuths
    ends: np.ndarray  # (N, 2) vertices of the segment
    share: np.ndarray  # (N,) of its second end
    radius: np.ndarray  # (N,) m
    normal: np.ndarray  # (N, 2) over its product with the ray


class OutlineRadii:
    """Comparison of an outline with a mesh; ``turn``: direction of the warp in the outline."""

    nuisances = NUISANCES
    scale = _SCALE

    def __init__(
        self, outline: DrapeOutline, rig: Rig, edges: Edges, *, turn: Radians = 0.0,
        weights: OutlineWeights | None = None,
    ) -> None:
        self.rig, self.weights = rig, weights or OutlineWeights()
        self._radius, self._edges = outline.radius, edges
        mean, deviation = UNKNOWN_PERSPECTIVE
        if not math.isnan(outline.height):
            mean = 1 / outline.height
            deviation = max(HEIGHT_DEVIATION * mean, 1e-3)
        self.start = np.array([turn, 0.0, 0.0, 0.0, mean])
        self.deviation = np.array([TURN_DEVIATION, PICTURE_DEVIATION, PICTURE_DEVIATION,
                                   SCALE_DEVIATION, deviation])
        seen = int(np.isfinite(outline.radius).sum())
        self._independent = seen / self.weights.patch
        self._factor = self.weights.patch**-0.5 / self.weights.sigma

    def residuals(self, positions: Points, nuisance: Nuisance) -> Residuals:
        """One residual for each azimuth that is seen."""
        found, _, _ = self._crossings(positions, nuisance)
        return self._bent(found)[0]

    def linearised(self, positions: Points, nuisance: Nuisance) -> Linearised:
        found, near, picture = self._crossings(positions, nuisance)
        residuals, slope = self._bent(found)
        slope = slope[:, None] * found.normal  # by moves in the picture
        turn, x, y, scale, perspective = nuisance
        axes = math.exp(scale) * _rotation(turn)
        zoom = 1 / (1 - perspective * positions[:, 2])

        def at_crossings(values: np.ndarray) -> np.ndarray:
            first, second = values[found.ends[:, 0]], values[found.ends[:, 1]]
            return first + found.share[:, None] * (second - first)

        def along(moves: Moves) -> np.ndarray:
            columns = []
            for move in moves:
                flat = zoom[:, None] * (move[:, :2] + near * perspective * move[:, 2:])
                columns.append((slope * at_crossings(flat @ axes.T)).sum(axis=1))
            return np.stack(columns, axis=1)

        about = picture - [x, y]
        by = [about @ np.array([[0.0, 1.0], [-1.0, 0.0]]), np.tile([1.0, 0.0], (len(near), 1)),
              np.tile([0.0, 1.0], (len(near), 1)), about,
              about * (zoom * positions[:, 2])[:, None]]
        by_nuisance = np.stack([(slope * at_crossings(part)).sum(axis=1) for part in by], axis=1)
        return Linearised(residuals, along, by_nuisance, self._independent)

    def radius(self, nuisance: Nuisance) -> np.ndarray:
        """(AZIMUTHS,) m: the captured outline in the specimen's axes, on the plate's plane; gaps
        are filled."""
        turn, x, y, scale, _ = nuisance
        seen = np.isfinite(self._radius)
        ray = np.stack([np.cos(AZIMUTH[seen]), np.sin(AZIMUTH[seen])], axis=1)
        points = (self._radius[seen, None] * ray - [x, y]) @ _rotation(turn) / math.exp(scale)
        azimuth = np.arctan2(points[:, 1], points[:, 0])
        order = np.argsort(azimuth)
        return np.interp(AZIMUTH, azimuth[order], np.hypot(*points.T)[order], period=2 * np.pi)

    def _crossings(
        self, positions: Points, nuisance: Nuisance
    ) -> tuple[_Crossings, np.ndarray, np.ndarray]:
        """Crossings, and the vertices (V, 2) on the plate's plane, in the specimen's axes and in
        the picture."""
        turn, x, y, scale, perspective = nuisance
        near = positions[:, :2] / (1 - perspective * positions[:, 2:])
        picture = math.exp(scale) * near @ _rotation(turn).T + [x, y]
        # The function crosses rays from azimuth 0 on.
        half = _rotation(-np.pi / AZIMUTHS)
        radius, which = crossings((picture @ half.T)[self._edges], AZIMUTHS)
        rows = np.flatnonzero(np.isfinite(self._radius) & (which >= 0))
        ends, ray = self._edges[which[rows]], np.stack([np.cos(AZIMUTH), np.sin(AZIMUTH)], axis=1)
        first, second = picture[ends[:, 0]], picture[ends[:, 1]]
        side = second - first
        crossing = radius[rows, None] * ray[rows]
        share = ((crossing - first) * side).sum(axis=1) / (side**2).sum(axis=1)
        normal = side[:, ::-1] * [1.0, -1.0]
        normal /= (normal * ray[rows]).sum(axis=1)[:, None]
        return _Crossings(rows, ends, share, radius[rows], normal), near, picture

    def _bent(self, found: _Crossings) -> tuple[Residuals, np.ndarray]:
        """Residuals and their derivatives (N,) by a radius, 1/m."""
        gap = found.radius - self._radius[found.rows]
        sigma, limit = self.weights.sigma, self.weights.limit
        residual, slope = huber(gap / sigma, limit / sigma)
        return residual * self._factor * sigma, slope * self._factor


@dataclass(frozen=True)
class Hem:
    """The outline of a hem as a target of a specimen (:class:`.springs.Target`).

    Attributes:
        radius: (AZIMUTHS,) m, on the plate's plane, in the specimen's axes.
        perspective: 1/m, inverse height of the camera.
    """

    radius: np.ndarray
    perspective: float
    rig: Rig

    def place(self, rest: RestPoints) -> Points:
        """Cloth bends down behind the rim until it runs straight to the hem."""
        arcs = arc_lengths(rest, self.rig)
        curves = _profiles(arcs, self.rig.border(AZIMUTH), self.radius, self.perspective, self.rig)
        return positions_along(rest, curves, arcs, self.rig)

    def springs(self, scene: Scene, positions: Points, pull: float) -> Springs:
        return self.held(scene, positions, hem_near(scene, positions, self, reach=REACH), pull)

    def held(self, scene: Scene, positions: Points, vertices: np.ndarray, pull: float) -> Springs:
        """Springs that pull ``vertices`` (N,) radially to the outline; each has the weight of its
        share of the cloth beyond the plate."""
        x = positions[vertices]
        azimuth = np.arctan2(x[:, 1], x[:, 0])
        ray = np.stack([np.cos(azimuth), np.sin(azimuth), np.zeros(len(x))], axis=1)
        radius = self.at(azimuth) * (1 - self.perspective * x[:, 2])
        targets = radius[:, None] * ray + x * [0.0, 0.0, 1.0]
        area = scene.mesh.vertex_areas
        share = area[~scene.held].sum() / area[vertices].sum()
        return springs_to(targets, ray, scene, vertices, share * pull)

    def at(self, azimuth: np.ndarray) -> np.ndarray:
        """Radii, m, at azimuths (N,)."""
        return np.interp(azimuth, AZIMUTH, self.radius, period=2 * np.pi)


def hem_near(scene: Scene, positions: Points, hem: Hem, *, reach: Metres) -> np.ndarray:
    """Vertices (N,) of the mesh's border that lie within ``reach`` of the outline."""
    border = np.unique(scene.mesh.edges[scene.mesh.edge_faces[:, 1] < 0])
    x = positions[border]
    radius = np.hypot(x[:, 0], x[:, 1]) / (1 - hem.perspective * x[:, 2])
    return border[np.abs(radius - hem.at(np.arctan2(x[:, 1], x[:, 0]))) < reach]


def _profiles(
    arcs: np.ndarray, hem: np.ndarray, radius: np.ndarray, perspective: float, rig: Rig
) -> np.ndarray:
    """(N, A, 2) radius and height at ``arcs`` (A,) of N profiles whose ends, at the arc lengths of
    the flat hem (N,), appear at ``radius`` (N,)."""
    step = np.diff(arcs, prepend=0.0)
    bend = 1 - np.exp(-arcs / _BEND)

    def profile(slope: np.ndarray) -> np.ndarray:
        angle = slope[:, None] * bend
        return np.stack([rig.plate_radius + np.cumsum(step * np.cos(angle), axis=1),
                         -np.cumsum(step * np.sin(angle), axis=1)], axis=2)

    low, high = np.zeros(len(hem)), np.full(len(hem), _STEEPEST)
    end = np.clip(np.searchsorted(arcs, hem - rig.plate_radius), 0, len(arcs) - 1)
    for _ in range(_ROUNDS):
        middle = (low + high) / 2
        ends = profile(middle)[np.arange(len(hem)), end]
        too_far = ends[:, 0] / (1 - perspective * ends[:, 1]) > radius
        low, high = np.where(too_far, middle, low), np.where(too_far, high, middle)
    return profile((low + high) / 2)


def _rotation(angle: float) -> np.ndarray:
    """(2, 2) counter-clockwise, of columns."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s], [s, c]])


