"""Synthetic photographs of a drape over the printed mat, as people take them with a phone.

A table, the mat on it, the stand, the plate and the cloth; light from the sky and from a lamp with
shadows; patterned cloth; a lens that distorts, blur, noise and JPEG.
"""

import io
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import trimesh
import yaml
from PIL import Image

from common.files import replace_file
from common.types import Density, Faces, Metres, Points, Radians, RestPoints
from data.pictures.mat import mat_colours, mat_pixels
from data.pictures.pose import Pose, camera_matrix
from data.pictures.reading import FULL_FRAME, decoded, encoded
from data.render.rays import Hits, RayScene

PATTERNS = ("plain", "stripes", "checks", "dots", "weave")
_SIZE = (2016, 1512)  # pixels, or upright
_REACH_A3 = 0.151  # m
_GAP = 0.4e-3  # m, of plate and stand from the cloth
_SKY, _LAMP_RAYS = 12, 6  # directions and points that shadows are averaged over
_COARSE = 4  # pixels between places at which the sky is seen


@dataclass(frozen=True)
class PhonePicture:
    """A photograph and what is true of it.

    Attributes:
        jpeg: the file, with the focal length in its EXIF.
        pose: the camera over the mat.
        warp: direction of the warp from the mat's arrow.
    """

    jpeg: bytes
    pose: Pose
    warp: Radians
    kind: dict

    def write(self, folder: Path, *, density: Density, tester: str, mat: str, plate_height: Metres
              ) -> None:
        """Write it to a ``folder`` as a user would, with ``capture.yaml``."""
        replace_file(folder / "outline.jpg", self.jpeg)
        replace_file(folder / "capture.yaml", yaml.safe_dump({
            "density_g_m2": round(1e3 * density, 6), "tester": tester,
            "warp_direction_deg": round(float(np.degrees(self.warp)), 3),
            "outline": {"mat": mat, "plate_height_mm": round(1e3 * plate_height, 1)}},
            sort_keys=False).encode())


def mat_around(reach: Metres) -> str:
    """The smallest mat that is seen around a flat specimen of this ``reach``."""
    return "a3" if reach < _REACH_A3 else "a2"


def phone_picture(
    positions: Points, rest: RestPoints, faces: Faces, rng: np.random.Generator, *,
    plate_radius: Metres, plate_height: Metres, mat: str = "a3", ground: str = "white",
    beside: Metres = 0.25, cloth_albedo: float | None = None
) -> PhonePicture:
    """A photograph by a random phone from a random place, at most ``beside`` the plate's axis;
    ``positions`` with the plate's centre as origin, z up, the warp along x; ``ground``: of the mat;
    ``cloth_albedo``: of plain cloth without colour, in place of a random pattern."""
    warp = float(rng.uniform(0, 2 * np.pi)) if rng.random() < 0.5 else 0.0
    cos, sin = np.cos(warp), np.sin(warp)
    turned = positions @ np.array([[cos, sin, 0], [-sin, cos, 0], [0, 0, 1.0]])
    cloth = turned + np.array([0, 0, plate_height])
    size = _SIZE if rng.random() < 0.7 else _SIZE[::-1]
    pose, stated = _random_pose(rng, size, plate_height, beside)
    stand = trimesh.creation.cylinder(0.4 * plate_radius, plate_height - _GAP)
    stand.apply_translation([0, 0, (plate_height - _GAP) / 2])
    plate = trimesh.creation.cylinder(plate_radius - _GAP, 3e-3, sections=96)
    plate.apply_translation([0, 0, plate_height - 1.5e-3 - _GAP])
    table = np.array([[-5, -5, 0], [5, -5, 0], [5, 5, 0], [-5, 5, 0.0]])
    scene = RayScene((cloth, faces), (plate.vertices, plate.faces), (stand.vertices, stand.faces),
                     (table, np.array([[0, 1, 2], [0, 2, 3]])))
    columns, rows = np.meshgrid(np.arange(size[0], dtype=float), np.arange(size[1], dtype=float))
    rays = _directions(pose, np.column_stack([columns.ravel(), rows.ravel()])).reshape(
        size[1], size[0], 3)
    hits = scene.cast(pose.place, rays)
    places = pose.place + np.minimum(hits.distance, 20)[..., None] * rays
    pattern = str(rng.choice(PATTERNS))
    kind = {"pattern": pattern, "lamp": float(rng.choice([0.0, 0.5, 1.0, 2.0])),
            "lamp_size": float(rng.uniform(0.02, 0.3))}
    albedo = _ground(places, mat, ground, rng)
    albedo[hits.mesh == 1] = rng.uniform(0.2, 0.7)
    albedo[hits.mesh == 2] = 0.3
    shown = hits.mesh == 0
    albedo[shown] = _pattern(_between(rest, faces, hits, shown), pattern, rng)
    if cloth_albedo is not None:
        albedo[shown] = cloth_albedo
    normals = _normals(hits, [cloth, plate.vertices, stand.vertices, table],
                       [faces, plate.faces, stand.faces, np.array([[0, 1, 2], [0, 2, 3]])], rays)
    light = albedo * _light(scene, places, normals, kind, rng)[..., None]
    return PhonePicture(_developed(light, rng, stated, size), pose, warp, kind)


def _random_pose(
    rng: np.random.Generator, size: tuple[int, int], plate_height: Metres, beside: Metres
) -> tuple[Pose, float]:
    """A pose, and the focal length, mm of full frame, that the file states."""
    equivalent = rng.uniform(24, 30)
    focal = equivalent / FULL_FRAME * float(np.hypot(*size))
    height = plate_height + rng.uniform(0.4, 1.5)
    aside, around = rng.uniform(0, beside), rng.uniform(0, 2 * np.pi)
    place = np.array([aside * np.cos(around), aside * np.sin(around), height])
    # It looks near the plate, at most 15 degrees off the vertical.
    aim = -place / np.linalg.norm(place)
    aim += rng.normal(0, 0.03, 3)
    aim /= np.linalg.norm(aim)
    off = np.arccos(-aim[2])
    if off > np.radians(15):
        aside = aim[:2] / np.linalg.norm(aim[:2])
        aim = np.array([*(np.sin(np.radians(15)) * aside), -np.cos(np.radians(15))])
    roll = rng.uniform(0, 2 * np.pi)
    right = np.array([np.cos(roll), np.sin(roll), 0.0])
    right -= (right @ aim) * aim
    right /= np.linalg.norm(right)
    turn = np.stack([right, np.cross(aim, right), aim])
    distortion = float(np.clip(rng.normal(0, 0.012), -0.03, 0.03))
    return Pose(size, focal, distortion, cv2.Rodrigues(turn)[0].ravel(), -turn @ place, 0.0,
                0.0), round(equivalent)


def _directions(pose: Pose, pixels: np.ndarray) -> np.ndarray:
    """Directions (N, 3) of the rays of pixels, over the mat."""
    lens = np.array([pose.distortion, 0, 0, 0])
    flat = cv2.undistortPoints(
        pixels[:, None], camera_matrix(pose.focal, pose.size), lens)[:, 0]
    rays = np.column_stack([flat, np.ones(len(flat))]) @ cv2.Rodrigues(pose.turn)[0]
    return rays / np.linalg.norm(rays, axis=1)[:, None]


def _ground(places: np.ndarray, mat: str, ground: str, rng: np.random.Generator) -> np.ndarray:
    """Albedo (H, W, 3) of table and mat."""
    tone = rng.uniform(0.1, 0.75) * np.exp(rng.normal(0, 0.1, 3))
    grain = 1 + rng.uniform(0, 0.08) * np.sin(
        places[..., 0] * rng.uniform(100, 400) + 3 * np.sin(30 * places[..., 1]))
    albedo = np.clip(tone * grain[..., None], 0.02, 0.95)
    picture = cv2.GaussianBlur(mat_colours(mat, ground), (0, 0), 1.0)
    height, width = picture.shape[:2]
    columns, rows = mat_pixels(mat, places)
    on = (columns >= 0) & (rows >= 0) & (columns <= width - 1) & (rows <= height - 1)
    paper = cv2.remap(picture, columns, rows, cv2.INTER_LINEAR)[on]
    albedo[on] = 0.04 + 0.81 * decoded(paper / 255)
    return albedo


def _pattern(flat: np.ndarray, kind: str, rng: np.random.Generator) -> np.ndarray:
    """Albedo (N, 3) of cloth at places (N, 2) of the flat specimen, m."""
    first = rng.uniform(0.03, 0.75) * np.exp(rng.normal(0, 0.35, 3))
    second = rng.uniform(0.03, 0.75) * np.exp(rng.normal(0, 0.35, 3))
    period = rng.uniform(0.008, 0.04)
    x, y = (flat / period).T
    share = {"plain": 0 * x, "stripes": (x % 1 < 0.5), "checks": ((x % 1 < 0.5) ^ (y % 1 < 0.5)),
             "dots": (np.hypot(x % 1 - 0.5, y % 1 - 0.5) < 0.3),
             "weave": 0.2 * (np.sin(40 * x) * np.sin(40 * y) > 0)}[kind].astype(float)
    return np.clip(first + share[:, None] * (second - first), 0.02, 0.92)


def _between(values: np.ndarray, faces: Faces, hits: Hits, shown: np.ndarray) -> np.ndarray:
    """Values (V, C) of vertices, interpolated where hits (H, W) are ``shown``."""
    weights = hits.uv[shown]
    weights = np.column_stack([1 - weights.sum(axis=1), weights])
    return (weights[..., None] * values[faces[hits.face[shown]]]).sum(axis=1)


def _normals(hits, points, triangles, rays) -> np.ndarray:  # type: ignore[no-untyped-def]
    normals = np.zeros(rays.shape)
    for k, (vertices, faces) in enumerate(zip(points, triangles, strict=True)):
        mesh = trimesh.Trimesh(vertices, faces, process=False)
        shown = hits.mesh == k
        if k == 0:  # smooth
            normals[shown] = _between(mesh.vertex_normals, faces, hits, shown)
        else:
            normals[shown] = mesh.face_normals[hits.face[shown]]
    normals /= np.maximum(np.linalg.norm(normals, axis=2, keepdims=True), 1e-9)
    return normals * -np.sign((normals * rays).sum(axis=2, keepdims=True))


def _light(
    scene: RayScene, places: np.ndarray, normals: np.ndarray, kind: dict, rng: np.random.Generator
) -> np.ndarray:
    """Light (H, W) at places with ``normals``: of the sky, and of a lamp."""
    # The sky at every fourth pixel, then smoothed along surfaces by averaging.
    coarse = slice(None, None, _COARSE), slice(None, None, _COARSE)
    there, up = places[coarse] + 1e-3 * normals[coarse], normals[coarse]
    sky = np.zeros(there.shape[:2])
    for k in range(_SKY):
        height = (k + 0.5) / _SKY
        around = k * 2.399963
        way = np.array([np.sqrt(1 - height**2) * np.cos(around),
                        np.sqrt(1 - height**2) * np.sin(around), height])
        spread = way + rng.normal(0, 0.2, there.shape)
        free = ~np.isfinite(scene.cast(there, spread).distance)
        sky += free * np.maximum(up @ way, 0) * 2 / _SKY
    height, width = places.shape[:2]
    sky = cv2.GaussianBlur(sky.astype(np.float32), (0, 0), 2.0)
    sky = cv2.resize(sky, (width, height), interpolation=cv2.INTER_LINEAR)
    total = 0.5 * sky
    if kind["lamp"]:
        azimuth = rng.uniform(0, 2 * np.pi)
        lamp = np.array([0.9 * np.cos(azimuth), 0.9 * np.sin(azimuth), rng.uniform(0.8, 2.0)])
        lit = np.zeros((height, width), np.float32)
        for _ in range(_LAMP_RAYS):
            way = lamp + kind["lamp_size"] * rng.normal(0, 0.5, places.shape) - places
            way /= np.linalg.norm(way, axis=2, keepdims=True)
            free = ~np.isfinite(scene.cast(places + 1e-3 * normals, way).distance)
            lit += (free * np.maximum((normals * way).sum(axis=2), 0) / _LAMP_RAYS).astype(
                np.float32)
        total = total + 0.5 * kind["lamp"] * cv2.GaussianBlur(lit, (0, 0), 2.0)
    return total


def _developed(
    light: np.ndarray, rng: np.random.Generator, equivalent: float, size: tuple[int, int]
) -> bytes:
    """JPEG of a picture (H, W, 3) of light, as a phone makes it."""
    white = np.quantile(light, 0.97) / rng.uniform(0.75, 1.0)
    tint = np.exp(rng.normal(0, 0.06, 3))
    sharp = cv2.GaussianBlur((light / white * tint).astype(np.float32), (0, 0),
                             rng.uniform(0.5, 1.2))
    rows, columns = np.indices(light.shape[:2]) / np.array(light.shape[:2])[:, None, None] - 0.5
    sharp *= (1 - rng.uniform(0, 0.5) * (rows**2 + columns**2))[..., None]  # darker corners
    noise = rng.uniform(0.003, 0.015)
    sharp += noise * np.sqrt(np.maximum(sharp, 0.01)) * rng.standard_normal(
        sharp.shape, dtype=np.float32)
    picture = np.rint(255 * encoded(np.clip(sharp, 0, 1))).astype(np.uint8)
    image = Image.fromarray(picture)
    exif = image.getexif()
    exif.get_ifd(0x8769)[41989] = int(equivalent)
    stream = io.BytesIO()
    image.save(stream, format="JPEG", quality=int(rng.integers(75, 96)), exif=exif)
    return stream.getvalue()
