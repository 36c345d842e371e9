"""Shaded images of draped cloth."""

import cv2
import numpy as np
import trimesh

from common.types import Faces, Metres, Outline, Points, Vector, Views
from data.render.raster import nearest_faces
from sim.mesh import vertex_normals

# Colours and intensities are linear, 0 to 1.
_CLOTH = np.array([0.42, 0.55, 0.72])
_STAND = np.array([0.62, 0.60, 0.57])
_LAMPS = (((-0.5, -0.6, 0.8), 0.75), ((0.9, -0.2, 0.3), 0.25), ((0.1, 0.9, 0.4), 0.15))
"""Direction towards each lamp as (right, away from the viewer, up), and its intensity."""
_AMBIENT = 0.22
_THUMBNAIL, _GAP = 120, 12  # pixels, height of thumbnails and gap between them
_VIEWER_DISTANCE = 2.0  # m, of the image plane from the centre
_MIDDLE = -0.07  # m, height of the picture's centre in views from the side


def shade(
    positions: Points,
    faces: Faces,
    *,
    plate_radius: Metres,
    elevation: float = 25.0,
    size: tuple[int, int] = (640, 520),
    field: Metres = 0.40,
    supersampling: int = 3,
) -> np.ndarray:
    """Orthographic image (H, W, 3) uint8 of a drape, z up, on its cylinder above a floor.

    Args:
        plate_radius: of the cylinder; 0 for none.
        elevation: of the viewer, who looks towards +y, degrees; 90 looks straight down with +y up.
        size, field: width and height, px; width of the picture.
        supersampling: rays along each side of a pixel.
    """
    floor = min(positions[:, 2].min(), -0.11) - 0.02
    meshes = [(positions, faces)]
    if plate_radius > 0:
        # Slightly lower and narrower than the plate, so that the cloth covers it.
        radius, top = 0.985 * plate_radius, -1e-3
        stand = trimesh.creation.revolve([[radius, floor], [radius, top], [0, top]], sections=96)
        meshes.append((stand.vertices, stand.faces))
    normals = np.concatenate([vertex_normals(*mesh) for mesh in meshes])
    width, height = size[0] * supersampling, size[1] * supersampling
    right, up, forward = _view(elevation)
    pixel = field / width
    x = (np.arange(width) + 0.5 - width / 2) * pixel
    y = (height / 2 - np.arange(height) - 0.5) * pixel
    # From above, the plate is always in the middle.
    middle = np.array([0.0, 0.0, _MIDDLE if elevation < 80 else 0.0])
    starts = middle - _VIEWER_DISTANCE * forward + x[None, :, None] * right + y[:, None, None] * up
    points = np.concatenate([mesh[0] for mesh in meshes])
    triangles = np.concatenate([faces, *(mesh[1] + len(positions) for mesh in meshes[1:])])
    across, upwards, depth = ((points - middle) @ np.stack([right, up, forward], axis=1)).T
    # The rasteriser divides by depth and compares inverses: these make its rays parallel.
    inverse = 2.0 - depth
    camera = np.column_stack([across, -upwards, np.ones(len(points))]) / inverse[:, None]
    _, face = nearest_faces(camera, triangles, (
        1 / pixel, 1 / pixel, (width - 1) / 2, (height - 1) / 2), height, width)

    image = _background(starts, forward, floor, positions)
    for k, colour in enumerate((_CLOTH, _STAND)[:len(meshes)]):
        shown = (face >= 0) & ((face >= len(faces)) == (k == 1))
        corners = triangles[face[shown]]
        weights = _barycentric(points[corners] @ np.stack([right, up], axis=1),
                               (starts[shown] @ np.stack([right, up], axis=1)))
        normal = (weights[..., None] * normals[corners]).sum(axis=1)
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        normal *= -np.sign(normal @ forward)[:, None]  # two-sided shading
        image[shown] = colour * _illumination(normal, right, up, forward)[:, None]
    image = image.reshape(size[1], supersampling, size[0], supersampling, 3).mean((1, 3))
    return (255 * np.clip(image, 0, 1) ** (1 / 2.2)).round().astype(np.uint8)


def _barycentric(corners: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Weights (N, 3) of the corners (N, 3, 2) of triangles at places (N, 2) in them."""
    a, b, c = np.moveaxis(corners, 1, 0)
    u, v, w = b - a, c - a, places - a
    twice = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
    twice = np.where(np.abs(twice) < 1e-15, 1e-15, twice)
    second = (w[:, 0] * v[:, 1] - w[:, 1] * v[:, 0]) / twice
    third = (u[:, 0] * w[:, 1] - u[:, 1] * w[:, 0]) / twice
    return np.clip(np.stack([1 - second - third, second, third], axis=1), 0, 1)


def _view(elevation: float) -> tuple[Vector, Vector, Vector]:
    """Directions right, up and forward of the view."""
    c, s = np.cos(np.radians(elevation)), np.sin(np.radians(elevation))
    return np.array([1.0, 0.0, 0.0]), np.array([0.0, s, c]), np.array([0.0, c, -s])


def _illumination(normal: np.ndarray, right: Vector, up: Vector, forward: Vector) -> np.ndarray:
    """Light (N,) on normals (N, 3): lamps, fixed to the viewer, and ambient light."""
    light = _AMBIENT * (0.6 + 0.4 * normal[:, 2])
    for (x, y, z), strength in _LAMPS:
        lamp = x * right + y * forward + z * up
        light = light + strength * np.maximum(normal @ (lamp / np.linalg.norm(lamp)), 0.0)
    return light


def _background(
    starts: np.ndarray, forward: Vector, floor: Metres, positions: Points
) -> np.ndarray:
    """Background (H, W, 3), nearly white, with a soft round shadow on a visible floor."""
    image = np.ones((*starts.shape[:2], 3)) * 0.93
    if forward[2] < -1e-3:
        reach = (floor - starts[..., 2]) / forward[2]
        ground = starts + reach[..., None] * forward
        radius = np.hypot(ground[..., 0], ground[..., 1])
        extent = np.hypot(positions[:, 0], positions[:, 1]).max()
        shadow = 1.0 / (1.0 + np.exp((radius - 0.9 * extent) / (0.12 * extent)))
        image *= (1.0 - 0.35 * shadow)[..., None]
    return image


def outline_thumbnail(curve: Outline | None) -> bytes:
    """PNG of the area within an outline; empty for None."""
    picture = np.full((_THUMBNAIL, _THUMBNAIL), 255, np.uint8)
    if curve is not None:
        points = curve * [1, -1] * (0.48 * _THUMBNAIL / np.abs(curve).max()) + _THUMBNAIL / 2
        cv2.fillPoly(picture, [np.rint(points).astype(np.int32)], 90)
    return cv2.imencode(".png", picture)[1].tobytes()


def thumbnails(views: Views) -> bytes:
    """PNG of depth images side by side, cropped to the cloth; near parts are bright."""
    tiles = []
    for view in views:
        rows, columns = np.nonzero(view > 0)
        cut = view[rows.min() : rows.max() + 1, columns.min() : columns.max() + 1]
        near, far = np.quantile(cut[cut > 0], (0.01, 0.99))
        bright = np.clip(255 * (far - cut) / max(far - near, 1e-6), 0, 255).astype(np.uint8)
        picture = cv2.applyColorMap(bright, cv2.COLORMAP_VIRIDIS)
        picture[cut == 0] = 255
        width = max(1, round(_THUMBNAIL * cut.shape[1] / cut.shape[0]))
        tiles += [cv2.resize(picture, (width, _THUMBNAIL), interpolation=cv2.INTER_AREA),
                  np.full((_THUMBNAIL, _GAP, 3), 255, np.uint8)]
    return cv2.imencode(".png", np.hstack(tiles[:-1]))[1].tobytes()
