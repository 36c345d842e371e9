"""Objective: depth views, compared pixel by pixel with the simulated drape.

Where both show cloth, the residual is the difference in z-depth. Its derivative is that of the
plane of the triangle that the pixel's ray d hits: a move v of a plane with normal n changes the
depth by n·v / n·d. Further residuals compare the silhouettes: signed distances, in pixels, from the
border of the simulated silhouette to that of the captured one; their derivative is the move of the
border's points in the image.

Pixels beside a depth discontinuity, where one fold occludes another, are excluded.

Both kinds are normalised to a fixed number of independent measurements, so that the value does not
decrease with the visible area, and is a negative log likelihood.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import (
    binary_erosion,
    distance_transform_edt,
    gaussian_filter,
    maximum_filter,
    median_filter,
    minimum_filter,
)

from common.types import Faces, Radians
from data.render.cameras import Camera
from data.render.rays import RayScene
from drapenet.refine.objective import Linearised, huber
from drapenet.views.located import LocatedViews

POSE = ("turn", "tilt_x", "tilt_y", "shift_x", "shift_y", "shift_z")
FOCAL, BORDER = "log_focal", "border"
"""Logarithm of the focal length over the camera's; px by which masks are too small."""
_SCALES = dict(zip((*POSE, FOCAL, BORDER), (0.05, 0.01, 0.01, 3e-3, 3e-3, 3e-3, 0.01, 0.5),
                   strict=True))
"""Typical steps, rad and m; of the focal length, relative."""
TABLE_SCALE = 0.03  # rad
TABLE_DEVIATION = np.radians(2.5)  # standard deviations as in configs/setup/real.yaml
FOCAL_DEVIATION, BORDER_DEVIATION = 0.01, 1.0
EDGE = 1.75e-3
"""m, at the plate's rim of the mesh for which :class:`DepthWeights` is stated."""


@dataclass(frozen=True)
class DepthWeights:
    """Noise model and sampling of the pixels.

    Attributes:
        sigma: m, standard deviation of a depth: noise and model error.
        limit: m, difference beyond which the cost is linear.
        border_sigma: px, the same of the silhouette's border; border_limit: px.
        stride: of the depth pixels compared, in rows and columns.
        jump: m, range of depths within 3 x 3 pixels that is a discontinuity.
        patch: px, side of a patch whose errors count as one measurement, on a mesh with edges of
            :data:`EDGE` at the rim: noise of neighbours is correlated, and the mesh's effect on
            folds more so. Intervals have nominal coverage (``python -m experiments refine_views``).
    """

    sigma: float = 1e-3
    limit: float = 4e-3
    border_sigma: float = 0.7
    border_limit: float = 4.0
    stride: int = 2
    jump: float = 12e-3
    patch: float = 18.0

    def on_mesh(self, edge: float) -> "DepthWeights":
        """The weights for cloth on a mesh with edges of ``edge``, m, at the rim.

        The number of independent pixels is proportional to that of the mesh's triangles.
        """
        return replace(self, patch=self.patch * edge / EDGE)


@dataclass(frozen=True)
class _View:
    """One captured view: compared pixels, and the distance map of the silhouette."""

    columns: np.ndarray  # (N,) of compared pixels
    rows: np.ndarray
    depth: np.ndarray  # (N,) m
    normal: np.ndarray  # (N, 3) of the surface, camera axes
    distance: np.ndarray  # (H, W) px, negative inside, 0 on the border's pixels
    slope: np.ndarray  # (2, H, W) of the distance by column and row


@dataclass(frozen=True)
class _Hits:
    """Intersections of rays with the cloth, in the specimen's axes.

    ``face`` (N,), ``weights`` (N, 3) of its corners, ``point`` (N, 3), ``normal`` (N, 3) divided
    by its product with the ray, so that a move v changes the depth by normal·v, ``depth`` (N,).
    """

    face: np.ndarray
    weights: np.ndarray
    point: np.ndarray
    normal: np.ndarray
    depth: np.ndarray


@dataclass(frozen=True)
class _Part:
    """Residuals of one kind in one view.

    ``residual`` (N,), its derivatives ``slope`` (N, 3) by a move, m, of the cloth that is hit, in
    the specimen's axes, and ``by_border`` (N,) by the nuisance :data:`BORDER`; ``hits``; of the
    view's pose ``rotation`` (3, 3) and ``changes``, the derivatives by all nuisances.
    """

    residual: np.ndarray
    slope: np.ndarray
    by_border: np.ndarray
    hits: _Hits
    rotation: np.ndarray
    changes: list[tuple[np.ndarray, np.ndarray]]


def _normalised(parts: Sequence[_Part], measurements: float) -> list[_Part]:
    """The parts with the weight of a number of independent measurements."""
    count = sum(len(part.residual) for part in parts)
    factor = np.sqrt(measurements / max(count, 1))
    return [replace(part, residual=factor * part.residual, slope=factor * part.slope,
                    by_border=factor * part.by_border) for part in parts]


def table_names(views: int) -> tuple[str, ...]:
    """Names of the table's deviations in all views but the first."""
    return tuple(f"table_{k}" for k in range(1, views))


class DepthViews:
    """Comparison of captured views with a mesh.

    The specimen is rotated by ``turn`` (rad, the warp's direction in the first view) and by
    ``turns`` in each view, plus the table's error ``table_k`` in all but the first. The world is
    tilted about its x and y axes and shifted, to correct the estimated pose of the camera.

    Args:
        faces: of the mesh.
        turn: initial guess of the nuisance.
        weights: noise model and sampling of the pixels.
    """

    def __init__(
        self,
        located: LocatedViews,
        faces: Faces,
        *,
        turn: Radians = 0.0,
        weights: DepthWeights | None = None,
    ) -> None:
        views, camera = located.views, located.camera
        self.camera, self.weights = camera, weights or DepthWeights()
        self._turns = located.turns
        self.nuisances = (*POSE, *table_names(len(views)), FOCAL, BORDER)
        self.start = np.array([turn, *[0.0] * (len(self.nuisances) - 1)])
        self.scale = np.array([_SCALES.get(name, TABLE_SCALE) for name in self.nuisances])
        known = dict.fromkeys(POSE, np.inf) | {FOCAL: FOCAL_DEVIATION, BORDER: BORDER_DEVIATION}
        self.deviation = np.array([known.get(name, TABLE_DEVIATION) for name in self.nuisances])
        self._faces = faces
        self._nominal_rays = camera.directions()
        self._views = [_prepare(view, camera, self.weights) for view in views]
        pixels = sum(len(view.depth) for view in self._views)
        border = sum(int(_border(view.distance <= 0).sum()) for view in self._views)
        self._measurements = (pixels * self.weights.stride**2 / self.weights.patch**2,
                              border / self.weights.patch)

    def residuals(self, positions: np.ndarray, nuisance: np.ndarray) -> np.ndarray:
        """Residuals (N,): depths, then borders."""
        return self._evaluate(positions, nuisance, derivatives=False).residuals

    def linearised(self, positions: np.ndarray, nuisance: np.ndarray) -> Linearised:
        """Residuals and derivatives, with constant visibility."""
        return self._evaluate(positions, nuisance, derivatives=True)

    def render(self, positions: np.ndarray, nuisance: np.ndarray) -> np.ndarray:
        """Views (K, H, W) z-depth, m, of the drape at ``positions`` (V, 3), m."""
        scene = RayScene((positions, self._faces))
        views = []
        for k in range(len(self._views)):
            rotation, shift, _ = self._pose(k, nuisance)
            directions = self._directions(nuisance)
            face = scene.cast(-rotation.T @ shift, directions @ rotation).face
            seen = np.nonzero(face >= 0)
            view = np.zeros(face.shape)
            view[seen] = self._hits(positions, face[seen], directions[seen], rotation, shift).depth
            views.append(view)
        return np.stack(views)

    def points(self, nuisance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The captured surface: points (N, 3), m, in the specimen's axes, and its normals (N, 3).

        Of the compared pixels; normals towards the camera, of slightly smoothed depth.
        """
        points, normals = [], []
        for k, view in enumerate(self._views):
            rotation, shift, _ = self._pose(k, nuisance)
            rays = self._directions(nuisance)[view.rows, view.columns]
            points.append((rays * view.depth[:, None] - shift) @ rotation)
            normals.append(view.normal @ rotation)
        return np.concatenate(points), np.concatenate(normals)

    def _evaluate(
        self, positions: np.ndarray, nuisance: np.ndarray, *, derivatives: bool
    ) -> Linearised:
        scene, directions = RayScene((positions, self._faces)), self._directions(nuisance)
        depths, borders = [], []
        for k, view in enumerate(self._views):
            rotation, shift, changes = self._pose(k, nuisance)
            rays = scene.cast(-rotation.T @ shift, directions @ rotation)
            face, depth = rays.face, np.where(rays.face >= 0, rays.distance, 0.0)
            both = _smooth(depth, self.weights.jump)[view.rows, view.columns]
            pixels = view.rows[both], view.columns[both]
            hits = self._hits(positions, face[pixels], directions[pixels], rotation, shift)
            depths.append(_Part(*self._depths(view.depth[both], hits), hits, rotation, changes))
            pixels = np.nonzero(_border(face >= 0))
            hits = self._hits(positions, face[pixels], directions[pixels], rotation, shift)
            residual, slope, by_border = self._borders(view, pixels, directions[pixels], hits,
                                                       nuisance)
            borders.append(_Part(residual, slope @ rotation, by_border, hits, rotation, changes))
        parts = [*_normalised(depths, self._measurements[0]),
                 *_normalised(borders, self._measurements[1])]
        residuals = np.concatenate([part.residual for part in parts])
        if not derivatives:
            return Linearised(residuals, None, None, sum(self._measurements))
        corners = np.concatenate([self._faces[part.hits.face] for part in parts])
        weights = np.concatenate([part.hits.weights for part in parts])
        slopes = np.concatenate([part.slope for part in parts])

        def along(moves: np.ndarray) -> np.ndarray:
            return np.stack([
                sum(weights[:, i] * (slopes * move[corners[:, i]]).sum(1) for i in range(3))
                for move in moves], axis=1)

        by_nuisance = np.concatenate([
            np.stack([((part.hits.point @ turn.T + shift) * (part.slope @ part.rotation.T)).sum(1)
                      for turn, shift in part.changes], axis=1)
            for part in parts])
        by_nuisance[:, self.nuisances.index(BORDER)] = np.concatenate(
            [part.by_border for part in parts])
        return Linearised(residuals, along, by_nuisance, sum(self._measurements))

    def _depths(
        self, captured: np.ndarray, hits: _Hits
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Residuals (N,) of captured depths (N,), m, and derivatives as in :class:`_Part`."""
        own = self.weights
        residual, slope = huber((hits.depth - captured) / own.sigma, own.limit / own.sigma)
        return residual, slope[:, None] / own.sigma * hits.normal, np.zeros(len(residual))

    def _borders(
        self, view: _View, pixels: tuple[np.ndarray, np.ndarray], rays: np.ndarray, hits: _Hits,
        nuisance: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Residuals (N,) of the simulated border's pixels, rows and columns, and derivatives as in
        :class:`_Part`, but in the camera's axes.
        """
        own = self.weights
        distance = view.distance[pixels] - self._value(BORDER, nuisance)
        residual, slope = huber(distance / own.border_sigma, own.border_limit / own.border_sigma)
        gradient = self._picture_gradient(view.slope[:, pixels[0], pixels[1]], rays, hits,
                                          self._zoom(nuisance))
        return residual, slope[:, None] / own.border_sigma * gradient, -slope / own.border_sigma

    def _directions(self, nuisance: np.ndarray) -> np.ndarray:
        """Rays through the pixels (H, W, 3), z = 1, with the focal length of the nuisances."""
        return self._nominal_rays / [self._zoom(nuisance), self._zoom(nuisance), 1.0]

    def _zoom(self, nuisance: np.ndarray) -> float:
        """Focal length over the camera's."""
        return float(np.exp(self._value(FOCAL, nuisance)))

    def _value(self, name: str, nuisance: np.ndarray) -> float:
        return float(nuisance[self.nuisances.index(name)])

    def _hits(
        self,
        positions: np.ndarray,
        face: np.ndarray,
        directions: np.ndarray,
        rotation: np.ndarray,
        shift: np.ndarray,
    ) -> _Hits:
        """Intersections of rays (N, 3), camera axes, with planes of triangles (N,), in float64."""
        origin = -rotation.T @ shift
        ray = directions @ rotation
        a, b, c = (positions[self._faces[face, i]] for i in range(3))
        normal = np.cross(b - a, c - a)
        steep = (normal * ray).sum(1)
        squared = (normal * normal).sum(1)
        # The depth of triangles seen edge-on is ill-conditioned.
        least = 1e-3 * np.sqrt(squared)
        steep = np.where(np.abs(steep) < least, np.copysign(least, steep), steep)
        depth = (normal * (a - origin)).sum(1) / steep
        point = origin + depth[:, None] * ray
        second = (np.cross(c - a, point - a) * -normal).sum(1) / squared
        third = (np.cross(b - a, point - a) * normal).sum(1) / squared
        weights = np.stack([1 - second - third, second, third], axis=1)
        return _Hits(face, weights, point, normal / steep[:, None], depth)

    def _picture_gradient(
        self, slope: np.ndarray, rays: np.ndarray, hits: _Hits, zoom: float
    ) -> np.ndarray:
        """(N, 3) change of the distance map, px, by the move of a point in camera axes, m."""
        x, y = rays[:, :2].T
        across, down = slope[0] * self.camera.fx * zoom, slope[1] * self.camera.fy * zoom
        return np.stack([across, down, -(across * x + down * y)], axis=1) / hits.depth[:, None]

    def _pose(
        self, k: int, nuisance: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, list[tuple[np.ndarray, np.ndarray]]]:
        """Specimen to camera in view k: rotation (3, 3), shift (3,), and their derivatives."""
        values = dict(zip(self.nuisances, nuisance, strict=True))
        table = f"table_{k}"
        turn, turn_slope = _rotation(
            2, values["turn"] + self._turns[k] + values.get(table, 0.0))
        about_x, x_slope = _rotation(0, values["tilt_x"])
        about_y, y_slope = _rotation(1, values["tilt_y"])
        outer, place = np.split(self.camera.world_to_camera[:3], [3], axis=1)
        shift = np.array([values[f"shift_{axis}"] for axis in "xyz"])
        zero, none = np.zeros(3), np.zeros((3, 3))
        changes = {name: (none, outer[:, i]) for i, name in enumerate(POSE[3:])}
        changes["turn"] = outer @ about_x @ about_y @ turn_slope, zero
        changes["tilt_x"] = outer @ x_slope @ about_y @ turn, zero
        changes["tilt_y"] = outer @ about_x @ y_slope @ turn, zero
        changes[table] = changes["turn"]
        rotation, shift = outer @ about_x @ about_y @ turn, outer @ shift + place[:, 0]
        # A longer focal length acts like a stretch of the specimen across the optical axis.
        across = np.array([1.0, 1.0, 0.0])
        changes[FOCAL] = across[:, None] * rotation, across * shift
        return (rotation, shift,
                [changes.get(name, (none, zero)) for name in self.nuisances])


def _rotation(axis: int, angle: float) -> tuple[np.ndarray, np.ndarray]:
    """Rotation (3, 3) about a coordinate axis, and its derivative."""
    i, j = (axis + 1) % 3, (axis + 2) % 3
    c, s = np.cos(angle), np.sin(angle)
    matrix, slope = np.eye(3), np.zeros((3, 3))
    matrix[i, i] = matrix[j, j] = c
    matrix[i, j], matrix[j, i] = -s, s
    slope[i, i] = slope[j, j] = -s
    slope[i, j], slope[j, i] = -c, c
    return matrix, slope


def _border(cloth: np.ndarray) -> np.ndarray:
    """Pixels of cloth (H, W) with background beside them, except at the image's edge."""
    return cloth & ~binary_erosion(cloth, border_value=1)


def _smooth(view: np.ndarray, jump: float) -> np.ndarray:
    """Pixels (H, W) of cloth without background or a discontinuity beside them."""
    nearest = minimum_filter(view, 3)
    return (nearest > 0) & (maximum_filter(view, 3) - nearest < jump)


def _prepare(view: np.ndarray, camera: Camera, weights: DepthWeights) -> _View:
    cloth = view > 0
    # Missing pixels are not background; the median fills them and preserves straight borders.
    filled = median_filter(cloth.astype(np.uint8), 3) > 0
    outside, inside = distance_transform_edt(~filled), distance_transform_edt(filled)
    distance = gaussian_filter(np.where(filled, 1.0 - inside, outside), 0.7)
    slope = np.stack(np.gradient(distance)[::-1])
    grid = np.zeros_like(cloth)
    grid[:: weights.stride, :: weights.stride] = True
    rows, columns = np.nonzero(_smooth(view, weights.jump) & grid)
    return _View(columns, rows, view[rows, columns].astype(np.float64),
                 _normals(view, camera)[rows, columns], distance, slope)


def _normals(view: np.ndarray, camera: Camera) -> np.ndarray:
    """Normals (H, W, 3) of a view's surface, camera axes, towards the camera."""
    weight = gaussian_filter((view > 0).astype(np.float64), 1.0)
    depth = gaussian_filter(view.astype(np.float64), 1.0) / np.maximum(weight, 1e-6)
    points = camera.back_project(depth)
    down, right = np.gradient(points, axis=(0, 1))
    normal = np.cross(down, right)
    normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-30)
    return -np.sign((normal * points).sum(-1, keepdims=True)) * normal
