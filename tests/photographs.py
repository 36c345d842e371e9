"""Drawn photographs of a drape of seven folds from above, and captures of them."""

import io
from pathlib import Path

import cv2
import numpy as np
import yaml
from PIL import Image
from scipy.spatial import cKDTree

from data.captures.capture import OutlineCapture
from data.pictures.mat import PIXEL, mat_colours
from data.pictures.reading import FULL_FRAME, decoded, encoded

ANGLE = np.linspace(0, 2 * np.pi, 1440, endpoint=False)
AROUND = np.column_stack([np.cos(ANGLE), np.sin(ANGLE)])
RADIUS = 0.118 + 0.012 * np.cos(7 * ANGLE + 1) + 0.005 * np.cos(ANGLE) + 0.003 * np.sin(4 * ANGLE)
CURVE = RADIUS[:, None] * AROUND
CENTROID = RADIUS**3 @ AROUND / (1.5 * (RADIUS**2).sum())
FIELD, PLACE = 0.4, (0.012, -0.007)  # m: side of a picture, plate's centre from its middle


def drawn(curve=CURVE, *, pixel=4e-4, cloth=50, ground=210, at=PLACE) -> np.ndarray:
    """Grey (H, W) uint8; a pixel at the edge has the mean of the light on both sides."""
    size, fine = round(FIELD / pixel), 4
    share = np.zeros((fine * size, fine * size), np.uint8)
    corners = fine * ((curve + at) * [1, -1] + FIELD / 2) / pixel - 0.5
    cv2.fillPoly(share, [np.rint(corners * 16).astype(np.int32)], 255, shift=4)
    share = cv2.resize(share, (size, size), interpolation=cv2.INTER_AREA) / 255
    light = decoded(np.array([ground, cloth]) / 255)
    return np.rint(255 * encoded(light[0] + share * (light[1] - light[0]))).astype(np.uint8)


def plate(pixel=4e-4, at=PLACE, down=0) -> dict:
    x, y = (np.array(at) * [1, -1] + FIELD / 2) / pixel - 0.5
    return {"x": float(x), "y": float(y + down), "diameter": 0.180 / pixel}


def uneven(picture: np.ndarray) -> np.ndarray:
    rows, columns = np.indices(picture.shape) / picture.shape[0] - 0.5
    return picture * (1 + 0.3 * rows + 0.2 * columns)


def noisy(picture: np.ndarray) -> np.ndarray:
    blurred = cv2.GaussianBlur(decoded(picture / 255), (0, 0), 1.5)  # a lens blurs light
    return 255 * encoded(blurred) + np.random.default_rng(0).normal(0, 8, picture.shape)


def write(folder: Path, content: np.ndarray | str, name: str = "outline.png", **changes) -> Path:
    """A capture of a picture, or of a text, with keys of capture.yaml."""
    folder.mkdir(exist_ok=True)
    if isinstance(content, str):
        (folder / name).write_text(content, encoding="utf-8")
    else:
        kept = content if content.dtype == np.uint16 else np.clip(content, 0, 255).astype(np.uint8)
        Image.fromarray(kept).save(folder / name)
    keys = {"density_g_m2": 150, "tester": "disc300_support180"} | changes
    (folder / "capture.yaml").write_text(yaml.safe_dump(keys))
    return folder


def write_over_mat(folder: Path, pictures: bytes | dict[str, bytes], **source: object) -> Path:
    """A capture of a picture over the mat, or of several by name; ``source``: keys of outline."""
    folder.mkdir(exist_ok=True)
    named = pictures if isinstance(pictures, dict) else {"outline.jpg": pictures}
    for name, data in named.items():
        (folder / name).write_bytes(data)
    return write(folder, "", "notes.txt", outline={"mat": "a2", "plate_height_mm": 150} | source)


def error_mm(capture: OutlineCapture, curve: np.ndarray = CURVE) -> float:
    """Largest distance of a point of ``curve``, m, from the outline of a capture, mm."""
    return float(distances_mm(capture, curve).max())


def distances_mm(capture: OutlineCapture, curve: np.ndarray = CURVE) -> np.ndarray:
    """Distances (N,), mm, of points of ``curve`` (N, 2), m, from the outline of a capture."""
    found = capture.outline.curve
    steps = np.linspace(0, 1, 20, endpoint=False)[:, None, None]
    dense = (found + steps * (np.roll(found, -1, axis=0) - found)).reshape(-1, 2)
    return 1e3 * cKDTree(dense).query(curve)[0]


def over_mat(
    curve=CURVE, *, mat="a2", ground="white", above=0.15, camera=1.2, focal=1800,
    cloth=(60, 60, 60), beside=(0.0, 0.0), changed=lambda picture: picture
) -> bytes:
    """JPEG of cloth of a colour with an outline in the plane of a plate ``above`` a printed mat,
    seen straight down from a ``camera``'s height and place ``beside`` the axis, all m, and a focal
    length in pixels, which EXIF states; ``changed``: the picture before the cloth is on it."""
    size = np.array([1600, 1200])
    paper = mat_colours(mat, ground)
    if ground == "code":  # whose dots are finer than pixels
        paper = cv2.GaussianBlur(paper, (0, 0), 0.4 * camera / focal / PIXEL)
    middle = (np.array(paper.shape[1::-1]) - 1) / 2
    scale = focal * PIXEL / camera
    shift = np.array(beside) * [-1, 1] * focal
    place = np.column_stack([scale * np.eye(2),
                             (size - 1) / 2 - scale * middle + shift / camera])
    picture = cv2.warpAffine(paper, place, size.tolist(), flags=cv2.INTER_AREA,
                             borderValue=[170] * 3)
    picture = changed(picture)
    corners = (size - 1) / 2 + (curve * [1, -1] * focal + shift) / (camera - above)
    cv2.fillPoly(picture, [np.rint(corners * 16).astype(np.int32)], cloth, cv2.LINE_AA, 4)
    exif = Image.Exif()
    exif.get_ifd(0x8769)[41989] = round(focal * FULL_FRAME / np.hypot(*size))
    stream = io.BytesIO()
    Image.fromarray(picture).save(stream, "JPEG", quality=95, exif=exif)
    return stream.getvalue()
