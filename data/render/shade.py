"""Shaded images of draped cloth."""

import cv2
import numpy as np
import trimesh

from common.types import Faces, Metres, Outline, Points, Vector, Views
from data.render.rays import RayScene
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
    normals = [vertex_normals(*mesh) for mesh in meshes]
    width, height = size[0] * supersampling, size[1] * supersampling
    right, up, forward = _view(elevation)
    pixel = field / width
    x = (np.arange(width) + 0.5 - width / 2) * pixel
    y = (height / 2 - np.arange(height) - 0.5) * pixel
    # From above, the plate is always in the middle.
    middle = np.array([0.0, 0.0, _MIDDLE if elevation < 80 else 0.0])
    starts = middle - _VIEWER_DISTANCE * forward + x[None, :, None] * right + y[:, None, None] * up
    hits = RayScene(*meshes).cast(starts, np.broadcast_to(forward, starts.shape))

    image = _background(starts, forward, floor, positions)
    for k, (colour, (_, triangles)) in enumerate(zip((_CLOTH, _STAND), meshes, strict=False)):
        shown = hits.mesh == k
        corners = triangles[hits.face[shown]]
        u, v = hits.uv[shown].T[..., None]
        n = normals[k]
        normal = (1 - u - v) * n[corners[:, 0]] + u * n[corners[:, 1]] + v * n[corners[:, 2]]
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        normal *= -np.sign(normal @ forward)[:, None]  # two-sided shading
        image[shown] = colour * _illumination(normal, right, up, forward)[:, None]
    image = image.reshape(size[1], supersampling, size[0], supersampling, 3).mean((1, 3))
    return (255 * np.clip(image, 0, 1) ** (1 / 2.2)).round().astype(np.uint8)


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


def silhouette(curve: Outline | None) -> bytes:
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
