"""Validated reading of pictures: every fault raises an InputError of one line."""

import itertools
import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from PIL import Image, UnidentifiedImageError

from common.documents import require_regular, shown
from common.errors import InputError, one_line

MIN_PICTURE = (80, 60)
MAX_PICTURE = (4096, 4096)
MAX_FILE_BYTES = 160 << 20  # bytes, of a picture
MAX_VIEWS = 8
MILLIMETRE = 1e-3  # m per count, the default

_MODES = {"L": "8-bit grey", "RGB": "8-bit colour", "RGBA": "8-bit colour", "1": "1-bit"}
"""Names of Pillow's modes for error messages."""


def read_picture(file: Path, *, modes: set[str], kind: str) -> np.ndarray:
    """Read a PNG (H, W, ...) whose Pillow mode is one of ``modes``, named ``kind`` in messages."""
    require_regular(file, MAX_FILE_BYTES, "picture")
    try:
        with Image.open(file, formats=["PNG"]) as picture:
            require_size(file, *picture.size)
            if picture.mode not in modes:
                mode = _MODES.get(picture.mode, picture.mode)
                raise InputError(f"{file} is an {mode} picture; it must be {kind}: export it as "
                                 "such")
            picture.verify()  # checksums, which are not checked when pixels are read
        with Image.open(file, formats=["PNG"]) as picture:
            return np.array(picture)
    except InputError:
        raise
    except UnidentifiedImageError:
        raise InputError(f"{file} is not a PNG picture; export the view again") from None
    except Exception as error:  # a damaged file may raise any error in the library
        raise InputError(f"{file} cannot be read ({one_line(error)}); export the view again"
                         ) from None


def numbered(folder: Path, pattern: str, *, most: int = MAX_VIEWS) -> list[Path]:
    """Files named ``pattern`` with 0 to K - 1 in place of ``{}``, K from 1 to ``most``."""
    shape = re.compile(re.escape(pattern).replace(r"\{\}", r"\d+"))
    found = {file.name for file in folder.iterdir() if shape.fullmatch(file.name)}
    if not found:
        others = sorted(file.name for file in folder.iterdir() if file.name != "capture.yaml")
        there = f" (the folder holds {shown(others[0])})" if others else ""
        raise InputError(f"{folder}: {pattern.format(0)} is missing{there}; name the one to "
                         f"{MAX_VIEWS} views {pattern.format(0)}, {pattern.format(1)} and so on")
    if len(found) > most:
        raise InputError(f"{folder} has {len(found)} files {pattern.format('*')}; at most {most} "
                         "are read: leave the others out")
    expected = [pattern.format(k) for k in range(len(found))]
    for name in expected:
        if name not in found:
            raise InputError(f"{folder}: {name} is missing, but {max(found)} exists; number them "
                             "from 0 on")
    return [folder / name for name in expected]


def join_views(pictures: Mapping[Path, np.ndarray]) -> np.ndarray:
    """Stack pictures by file (K, H, W); InputError if their sizes differ or two are identical."""
    (start, first), *_ = pictures.items()
    for file, picture in pictures.items():
        if picture.shape != first.shape:
            raise InputError(f"{file.parent}: {file.name} has {dimensions(picture)} pixels but "
                             f"{start.name} has {dimensions(first)}; all views must have one size")
    for (one, a), (other, b) in itertools.combinations(pictures.items(), 2):
        # Blank pictures are reported by data.captures.capture.
        if np.array_equal(a, b) and a.min() < a.max():
            raise InputError(f"{one.parent}: {one.name} and {other.name} are the same picture; "
                             "each view must be taken after the table has turned on")
    return np.stack(list(pictures.values()))


def median_depth(frames: np.ndarray) -> np.ndarray:
    """Median (H, W) float32 of frames (N, H, W) per pixel, without zeros (missing depth)."""
    seen = np.ma.masked_equal(frames.astype(np.float32), 0.0)
    return np.ma.filled(np.ma.median(seen, axis=0), 0.0)


def neighbours(pictures: np.ndarray) -> np.ndarray:
    """The eight neighbours (8, ..., H, W) of each pixel of pictures (..., H, W); 0 outside."""
    height, width = pictures.shape[-2:]
    padded = np.pad(pictures, [(0, 0)] * (pictures.ndim - 2) + [(1, 1), (1, 1)])
    return np.stack([padded[..., i : i + height, j : j + width]
                     for i in range(3) for j in range(3) if (i, j) != (1, 1)])


def dimensions(picture: np.ndarray) -> str:
    """Width and height of a picture (H, W), for messages."""
    return f"{picture.shape[1]}x{picture.shape[0]}"


def require_size(what: str | Path, width: int, height: int) -> None:
    """InputError for pictures, named ``what``, of a size out of range, px."""
    if not (MIN_PICTURE[0] <= width <= MAX_PICTURE[0]
            and MIN_PICTURE[1] <= height <= MAX_PICTURE[1]):
        raise InputError(
            f"{what}: {width}x{height} pixels; views have from "
            f"{MIN_PICTURE[0]}x{MIN_PICTURE[1]} to "
            f"{MAX_PICTURE[0]}x{MAX_PICTURE[1]}")
