"""Objective: depth views, compared pixel by pixel with the simulated drape.

Residuals are differences in z-depth, where a move v of the plane with normal n that the pixel's ray
d hits changes the depth by n·v / n·d, and signed distances between the silhouettes, in pixels. Both
are normalised to a fixed number of independent measurements: their value is a negative log
likelihood and does not decrease with the visible area.
"""

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

from common.types import DepthImage, Faces, Mask, Metres, Points, Radians, Views
from data.render.cameras import Camera
from data.render.raster import nearest_faces
from drapenet.refine.objective import Linearised, Moves, Nuisance, Residuals, huber
from drapenet.views.located import LocatedViews

POSE = ("turn", "tilt_x", "tilt_y", "shift_x", "shift_y", "shift_z")
FOCAL, BORDER = "log_focal", "border"  # over the camera's; px by which masks are too small
_SCALES = dict(zip((*POSE, FOCAL, BORDER), (0.05, 0.01, 0.01, 3e-3, 3e-3, 3e-3, 0.01, 0.5),
                   strict=True))  # typical steps
TABLE_SCALE = 0.03  # rad
TABLE_DEVIATION = np.radians(2.5)  # standard deviations as in configs/setup/real.yaml
FOCAL_DEVIATION, BORDER_DEVIATION = 0.01, 1.0
_DEVIATIONS = dict.fromkeys(POSE, np.inf) | {FOCAL: FOCAL_DEVIATION, BORDER: BORDER_DEVIATION}
EDGE = 1.75e-3  # m, at the rim of the mesh for which :class:`DepthWeights` is stated


@dataclass(frozen=True)
class DepthWeights:
    """Noise model and sampling of the pixels.

    ``patch`` is the side, px, of a patch whose errors count as one measurement: noise of neighbours
    is correlated, and the effects of mesh, friction and folds more so.
    """

    sigma: Metres = 1e-3  # standard deviation of a depth: noise and model error
    limit: Metres = 4e-3  # beyond which the cost is linear
    border_sigma: float = 0.7  # px, the same of the silhouette's border
    border_limit: float = 4.0  # px
    stride: int = 2  # of the depth pixels compared, in rows and columns
    jump: Metres = 12e-3  # range within 3 x 3 pixels that is a discontinuity
    patch: float = 36.0

    def on_mesh(self, edge: Metres) -> "DepthWeights":
        """Weights for another mesh; independent pixels are as many as its triangles."""
        return replace(self, patch=self.patch * edge / EDGE)


@dataclass(frozen=True)
class _View:
    """One captured view: N compared pixels, and the distance map of the silhouette."""

    columns: np.ndarray
    rows: np.ndarray
    depth: np.ndarray  # (N,) m
    normal: np.ndarray  # (N, 3) of the surface, camera axes
    distance: np.ndarray  # (H, W) px, negative inside, 0 on the border's pixels
    slope: np.ndarray  # (2, H, W) of the distance by column and row


@dataclass(frozen=True)
class _Pose:
    """Specimen to camera: rotation (3, 3), shift (3,), and their derivatives by each nuisance."""

    rotation: np.ndarray
    shift: np.ndarray
    changes: list[tuple[np.ndarray, np.ndarray]]

    @property
    def origin(self) -> np.ndarray:
        """(3,) m, the camera in the specimen's axes."""
        return -self.rotation.T @ self.shift


@dataclass(frozen=True)
class _Hits:
    """Intersections of N rays with the cloth, in the specimen's axes."""

    corners: np.ndarray  # (N, 3) vertices of the triangle
    weights: np.ndarray  # (N, 3) of the corners
    point: Points
    normal: np.ndarray  # (N, 3) over its product with the ray: a move v changes the depth by n·v
    depth: np.ndarray  # (N,) m


@dataclass(frozen=True)
class _Part:
    """N residuals of one kind in one view and their derivatives."""

    residual: Residuals
    slope: np.ndarray  # (N, 3) by a move, m, of the cloth that is hit, in the specimen's axes
    by_border: np.ndarray  # (N,) by :data:`BORDER`
    hits: _Hits
    pose: _Pose

    def by_pose(self) -> np.ndarray:
        """(N, K) derivatives by the nuisances through the pose."""
        slope = self.slope @ self.pose.rotation.T
        return np.stack([((self.hits.point @ turn.T + shift) * slope).sum(1)
                         for turn, shift in self.pose.changes], axis=1)


def _normalised(parts: list[_Part], measurements: float) -> list[_Part]:
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

    The specimen is rotated by the nuisance ``turn`` (rad, the warp's direction in the first view)
    and the table's turn, with its error ``table_k`` in all but the first view. The world is tilted
    about its x and y axes and shifted, to correct the estimated pose of the camera.
    """

    def __init__(
        self, located: LocatedViews, faces: Faces, *, turn: Radians = 0.0,
        weights: DepthWeights | None = None,
    ) -> None:
        self.camera, self.weights = located.camera, weights or DepthWeights()
        self._turns, self._faces = located.turns, faces
        self.nuisances = (*POSE, *table_names(len(located.views)), FOCAL, BORDER)
        self.start = np.array([turn, *[0.0] * (len(self.nuisances) - 1)])
        self.scale = np.array([_SCALES.get(name, TABLE_SCALE) for name in self.nuisances])
        self.deviation = np.array([_DEVIATIONS.get(name, TABLE_DEVIATION)
                                   for name in self.nuisances])
        self._nominal_rays = self.camera.directions()
        self._views = [_prepare(view, self.camera, self.weights) for view in located.views]
        pixels = sum(len(view.depth) for view in self._views)
        border = sum(int(_border(view.distance <= 0).sum()) for view in self._views)
        self._measurements = (pixels * self.weights.stride**2 / self.weights.patch**2,
                              border / self.weights.patch)

    def residuals(self, positions: Points, nuisance: Nuisance) -> Residuals:
        """Residuals of depths, then of borders."""
        return np.concatenate([part.residual for part in self._parts(positions, nuisance)])

    def linearised(self, positions: Points, nuisance: Nuisance) -> Linearised:
        """Residuals and derivatives, with constant visibility."""
        parts = self._parts(positions, nuisance)
        corners = np.concatenate([part.hits.corners for part in parts])
        weights = np.concatenate([part.hits.weights for part in parts])
        slopes = np.concatenate([part.slope for part in parts])

        def along(moves: Moves) -> np.ndarray:
            return np.stack([
                sum(weights[:, i] * (slopes * move[corners[:, i]]).sum(1) for i in range(3))
                for move in moves], axis=1)

        by_nuisance = np.concatenate([part.by_pose() for part in parts])
        by_nuisance[:, self.nuisances.index(BORDER)] = np.concatenate(
            [part.by_border for part in parts])
        return Linearised(np.concatenate([part.residual for part in parts]), along, by_nuisance,
                          sum(self._measurements))

    def render(self, positions: Points, nuisance: Nuisance) -> Views:
        """The views of a drape."""
        rays, views = self._rays(nuisance), []
        for k in range(len(self._views)):
            pose = self._pose(k, nuisance)
            _, face = self._nearest(positions, pose, nuisance)
            cloth = np.nonzero(face >= 0)
            view = np.zeros(face.shape)
            view[cloth] = self._hits(positions, face[cloth], rays[cloth], pose).depth
            views.append(view)
        return np.stack(views)

    def points(self, nuisance: Nuisance) -> tuple[Points, np.ndarray]:
        """Points and normals (N, 3) of the captured surface, in the specimen's axes."""
        points, normals = [], []
        for k, view in enumerate(self._views):
            pose = self._pose(k, nuisance)
            rays = self._rays(nuisance)[view.rows, view.columns]
            points.append((rays * view.depth[:, None] - pose.shift) @ pose.rotation)
            normals.append(view.normal @ pose.rotation)
        return np.concatenate(points), np.concatenate(normals)

    def _parts(self, positions: Points, nuisance: Nuisance) -> list[_Part]:
        """Residuals of the depths in all views, then those of the borders."""
        rays = self._rays(nuisance)
        depths, borders = [], []
        for k, view in enumerate(self._views):
            pose = self._pose(k, nuisance)
            depth, face = self._nearest(positions, pose, nuisance)
            smooth = _smooth(depth, self.weights.jump)
            both = smooth[view.rows, view.columns]
            pixels = view.rows[both], view.columns[both]
            hits = self._hits(positions, face[pixels], rays[pixels], pose)
            depths.append(self._depths(view.depth[both], hits, pose))
            pixels = np.nonzero(_border(face >= 0))
            hits = self._hits(positions, face[pixels], rays[pixels], pose)
            borders.append(self._borders(view, pixels, rays[pixels], hits, pose, nuisance))
        return [*_normalised(depths, self._measurements[0]),
                *_normalised(borders, self._measurements[1])]

    def _depths(self, captured: np.ndarray, hits: _Hits, pose: _Pose) -> _Part:
        """Residuals of captured depths (N,), m."""
        sigma, limit = self.weights.sigma, self.weights.limit
        residual, slope = huber((hits.depth - captured) / sigma, limit / sigma)
        return _Part(residual, slope[:, None] / sigma * hits.normal, np.zeros(len(residual)), hits,
                     pose)

    def _borders(
        self, view: _View, pixels: tuple[np.ndarray, ...], rays: np.ndarray, hits: _Hits,
        pose: _Pose, nuisance: Nuisance,
    ) -> _Part:
        """Residuals of the simulated border's pixels, rows and columns."""
        sigma = self.weights.border_sigma
        limit = self.weights.border_limit
        distance = view.distance[pixels] - nuisance[self.nuisances.index(BORDER)]
        residual, slope = huber(distance / sigma, limit / sigma)
        # Change of the distance map, px, by the move of a point in camera axes, m.
        x, y = rays[:, :2].T
        zoom = self._zoom(nuisance)
        by_column, by_row = view.slope[:, pixels[0], pixels[1]]
        across = by_column * self.camera.fx * zoom
        down = by_row * self.camera.fy * zoom
        gradient = np.stack([across, down, -(across * x + down * y)], axis=1) / hits.depth[:, None]
        return _Part(residual, slope[:, None] / sigma * gradient @ pose.rotation, -slope / sigma,
                     hits, pose)

    def _zoom(self, nuisance: Nuisance) -> float:
        return float(np.exp(nuisance[self.nuisances.index(FOCAL)]))

    def _rays(self, nuisance: Nuisance) -> np.ndarray:
        """Rays through the pixels (H, W, 3), camera axes, z = 1."""
        zoom = self._zoom(nuisance)
        return self._nominal_rays / [zoom, zoom, 1.0]

    def _nearest(
        self, positions: Points, pose: _Pose, nuisance: Nuisance
    ) -> tuple[DepthImage, np.ndarray]:
        """Depths (H, W) of a drape in a view, and the triangles that are seen."""
        camera, zoom = self.camera, self._zoom(nuisance)
        points = positions @ pose.rotation.T + pose.shift
        return nearest_faces(points.astype(np.float32), self._faces,
                             (zoom * camera.fx, zoom * camera.fy, camera.cx, camera.cy),
                             camera.height, camera.width)

    def _hits(self, positions: Points, face: np.ndarray, rays: np.ndarray, pose: _Pose) -> _Hits:
        """Intersections of rays (N, 3) with planes of triangles (N,), in double precision."""
        ray = rays @ pose.rotation
        corners = self._faces[face]
        a, b, c = (positions[corners[:, i]] for i in range(3))
        normal = np.cross(b - a, c - a)
        steep = (normal * ray).sum(1)
        squared = (normal * normal).sum(1)
        # The depth of triangles seen edge-on is ill-conditioned.
        least = 1e-3 * np.sqrt(squared)
        steep = np.where(np.abs(steep) < least, np.copysign(least, steep), steep)
        depth = (normal * (a - pose.origin)).sum(1) / steep
        point = pose.origin + depth[:, None] * ray
        second = (np.cross(c - a, point - a) * -normal).sum(1) / squared
        third = (np.cross(b - a, point - a) * normal).sum(1) / squared
        weights = np.stack([1 - second - third, second, third], axis=1)
        return _Hits(corners, weights, point, normal / steep[:, None], depth)

    def _pose(self, k: int, nuisance: Nuisance) -> _Pose:
        """The pose in view k."""
        values = dict(zip(self.nuisances, nuisance, strict=True))
        table = f"table_{k}"
        turn, turn_slope = _rotation(2, values["turn"] + self._turns[k] + values.get(table, 0.0))
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
        return _Pose(rotation, shift, [changes.get(name, (none, zero)) for name in self.nuisances])


def _rotation(axis: int, angle: Radians) -> tuple[np.ndarray, np.ndarray]:
    """Rotation (3, 3) about a coordinate axis, and its derivative."""
    i, j = (axis + 1) % 3, (axis + 2) % 3
    c, s = np.cos(angle), np.sin(angle)
    matrix, slope = np.eye(3), np.zeros((3, 3))
    matrix[i, i] = matrix[j, j] = c
    matrix[i, j], matrix[j, i] = -s, s
    slope[i, i] = slope[j, j] = -s
    slope[i, j], slope[j, i] = -c, c
    return matrix, slope


def _border(cloth: Mask) -> Mask:
    """Pixels of cloth with background beside them, except at the image's edge."""
    return cloth & ~binary_erosion(cloth, border_value=1)


def _smooth(view: DepthImage, jump: Metres) -> Mask:
    """Pixels of cloth without background or a discontinuity beside them."""
    nearest = minimum_filter(view, 3)
    return (nearest > 0) & (maximum_filter(view, 3) - nearest < jump)


def _prepare(view: DepthImage, camera: Camera, weights: DepthWeights) -> _View:
    cloth = view > 0
    # Missing pixels are not background; the median fills them and preserves straight borders.
    filled = median_filter(cloth.astype(np.uint8), 3) > 0
    outside = distance_transform_edt(~filled)
    inside = distance_transform_edt(filled)
    distance = gaussian_filter(np.where(filled, 1.0 - inside, outside), 0.7)
    slope = np.stack(np.gradient(distance)[::-1])
    grid = np.zeros_like(cloth)
    grid[:: weights.stride, :: weights.stride] = True
    rows, columns = np.nonzero(_smooth(view, weights.jump) & grid)
    return _View(columns, rows, view[rows, columns].astype(np.float64),
                 _normals(view, camera)[rows, columns], distance, slope)


def _normals(view: DepthImage, camera: Camera) -> np.ndarray:
    """Normals (H, W, 3) of a view's surface, camera axes, towards the camera."""
    weight = gaussian_filter((view > 0).astype(np.float64), 1.0)
    depth = gaussian_filter(view.astype(np.float64), 1.0) / np.maximum(weight, 1e-6)
    points = camera.back_project(depth)
    down, right = np.gradient(points, axis=(0, 1))
    normal = np.cross(down, right)
    normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-30)
    return -np.sign((normal * points).sum(-1, keepdims=True)) * normal
