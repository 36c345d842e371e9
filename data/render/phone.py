"""Synthetic photographs of a drape over the printed mat, as people take them with a phone: a scene
of :mod:`data.render.scenery`, a lens that distorts, blur, noise and JPEG.
"""

import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml
from PIL import Image

from common.files import replace_file
from common.types import ColourPicture, Density, Faces, Metres, Points, Radians, RestPoints
from data.pictures.pose import Pose, camera_matrix
from data.pictures.reading import FULL_FRAME, encoded
from data.render.hard import HARD
from data.render.scenery import Scenery
from data.rigs import described_tester
from sim.rig import Rig

_SIZE = (2016, 1512)  # pixels, or upright
_REACH_A3 = 0.151  # m


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

    def write(self, folder: Path, *, density: Density, rig: Rig, mat: str, plate_height: Metres,
              number: int | None = None) -> None:
        """Write it to a ``folder`` as a user would, with ``capture.yaml``; ``number``: of several
        pictures, from 1 on."""
        name = "outline.jpg" if number is None else f"outline_{number}.jpg"
        replace_file(folder / name, self.jpeg)
        replace_file(folder / "capture.yaml", yaml.safe_dump({
            "density_g_m2": round(1e3 * density, 6), "tester": described_tester(rig),
            "warp_direction_deg": round(float(np.degrees(self.warp)), 3),
            "outline": {"mat": mat, "plate_height_mm": round(1e3 * plate_height, 1)}},
            sort_keys=False).encode())


def mat_around(reach: Metres) -> str:
    """The smallest mat that is seen around a flat specimen of this ``reach``."""
    return "a3" if reach < _REACH_A3 else "a2"


def phone_picture(
    positions: Points, rest: RestPoints, faces: Faces, rng: np.random.Generator, **scene: Any
) -> PhonePicture:
    """One of :func:`phone_pictures`."""
    return phone_pictures(positions, rest, faces, rng, count=1, **scene)[0]


def phone_pictures(
    positions: Points, rest: RestPoints, faces: Faces, rng: np.random.Generator, *, count: int,
    plate_radius: Metres, plate_height: Metres, mat: str = "a3", beside: Metres = 0.25,
    lean: float = np.inf, ground: str = "white", size: tuple[int, int] | None = None,
    hard: Sequence[str] = (), **scene: Any
) -> list[PhonePicture]:
    """Photographs of one scene by a random phone from random places, at most ``beside`` the axis,
    and ``lean`` times their height above the plate.

    Args:
        positions: with the plate's centre as origin, z up, the warp along x.
        ground: of the mat.
        size: pixels along the long and the short side; None: three megapixels.
        hard: what makes the hem hard to see, of :data:`data.render.hard.HARD`.
        scene: as for :meth:`data.render.scenery.Scenery.random`.
    """
    warp = float(rng.uniform(0, 2 * np.pi)) if rng.random() < 0.5 else 0.0
    cos, sin = np.cos(warp), np.sin(warp)
    turned = positions @ np.array([[cos, sin, 0], [-sin, cos, 0], [0, 0, 1.0]])
    size = size or _SIZE
    size = size if rng.random() < 0.7 else size[::-1]
    lens = rng.uniform(24, 30), float(np.clip(rng.normal(0, 0.012), -0.03, 0.03))
    scenery = Scenery.random(
        turned + np.array([0, 0, plate_height]), rest, faces, rng, mat=mat, ground=ground,
        plate_radius=plate_radius, plate_height=plate_height,
        **{"clutter": False, "sheets": False, **scene})
    reach = float(np.hypot(*rest.T).max())
    for kind in hard:
        scenery = HARD[kind](scenery, reach, rng)
    columns, rows = np.meshgrid(np.arange(size[0], dtype=float), np.arange(size[1], dtype=float))
    pixels = np.column_stack([columns.ravel(), rows.ravel()])
    found = []
    for _ in range(count):
        pose = random_pose(rng, size, lens, plate_height, beside, lean)
        light, _ = scenery.seen(pose.place, rays_of(pose, pixels).reshape(*size[::-1], 3), rng)
        found.append(PhonePicture(as_jpeg(light, pose, rng), pose, warp, scenery.kind))
    return found


def as_jpeg(light: np.ndarray, pose: Pose, rng: np.random.Generator) -> bytes:
    """The file that a phone makes of light (H, W, 3), with the focal length in its EXIF."""
    image = Image.fromarray(exposed(light, rng, blur=rng.uniform(0.5, 1.2)))
    exif = image.getexif()
    exif.get_ifd(0x8769)[41989] = round(pose.focal / float(np.hypot(*pose.size)) * FULL_FRAME)
    stream = io.BytesIO()
    image.save(stream, format="JPEG", quality=int(rng.integers(75, 96)), exif=exif)
    return stream.getvalue()


def random_pose(
    rng: np.random.Generator, size: tuple[int, int], lens: tuple[float, float],
    plate_height: Metres, beside: Metres, lean: float,
    heights: tuple[Metres, Metres] = (0.4, 1.5)
) -> Pose:
    """A pose of a ``lens``: focal length, mm of full frame, and distortion k1; ``heights``: above
    the plate."""
    equivalent, distortion = lens
    focal = equivalent / FULL_FRAME * float(np.hypot(*size))
    height = plate_height + (above := rng.uniform(*heights))
    aside, around = rng.uniform(0, min(beside, lean * above)), rng.uniform(0, 2 * np.pi)
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
    return Pose(size, focal, distortion, cv2.Rodrigues(turn)[0].ravel(), -turn @ place, 0.0, 0.0)


def rays_of(pose: Pose, pixels: np.ndarray) -> np.ndarray:
    """Directions (N, 3) of the rays of pixels, over the mat."""
    lens = np.array([pose.distortion, 0, 0, 0])
    flat = cv2.undistortPoints(
        pixels[:, None], camera_matrix(pose.focal, pose.size), lens)[:, 0]
    rays = np.column_stack([flat, np.ones(len(flat))]) @ cv2.Rodrigues(pose.turn)[0]
    return rays / np.linalg.norm(rays, axis=1)[:, None]


def exposed(light: np.ndarray, rng: np.random.Generator, *, blur: float) -> ColourPicture:
    """The picture (H, W, 3) that a phone makes of light (H, W, 3), with a ``blur`` in pixels:
    exposure, white balance, darker corners and noise."""
    white = np.quantile(light, 0.97) / rng.uniform(0.75, 1.0)
    tint = np.exp(rng.normal(0, 0.06, 3))
    sharp = cv2.GaussianBlur((light / white * tint).astype(np.float32), (0, 0), blur)
    rows, columns = np.indices(light.shape[:2]) / np.array(light.shape[:2])[:, None, None] - 0.5
    sharp *= (1 - rng.uniform(0, 0.5) * (rows**2 + columns**2))[..., None]
    noise = rng.uniform(0.003, 0.015)
    sharp += noise * np.sqrt(np.maximum(sharp, 0.01)) * rng.standard_normal(
        sharp.shape, dtype=np.float32)
    return np.rint(255 * encoded(np.clip(sharp, 0, 1))).astype(np.uint8)
