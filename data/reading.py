"""Guarded reading of pictures: every fault becomes an InputError of one line."""

import itertools
import re
from pathlib import Path

import numpy as np
from PIL import Image, UnidentifiedImageError

from common.documents import require_regular
from common.errors import InputError, one_line

SMALLEST_PICTURE = (80, 60)
LARGEST_PICTURE = (4096, 4096)
LARGEST_FILE = 160 << 20  # bytes, of a picture
MOST_VIEWS = 8
MILLIMETRE = 1e-3  # m, per count unless stated


def read_picture(file: Path, *, modes: set[str], kind: str) -> np.ndarray:
    """Counts (H, W) of a PNG whose Pillow mode is one of ``modes``, called ``kind`` in messages."""
    require_regular(file, LARGEST_FILE, "picture")
    try:
        with Image.open(file, formats=["PNG"]) as picture:
            require_size(file, *picture.size)
            if picture.mode not in modes:
                raise InputError(f"{file}: picture of kind {picture.mode}; it must be {kind}")
            picture.verify()  # checksums, which reading the pixels does not check
        with Image.open(file, formats=["PNG"]) as picture:
            return np.array(picture)
    except InputError:
        raise
    except UnidentifiedImageError:
        raise InputError(f"{file} is not a PNG picture; export the view again") from None
    except Exception as error:  # whatever a damaged file makes of the library
        cause = one_line(error)
        raise InputError(f"{file} cannot be read ({cause}); export the view again") from None


def read_views(folder: Path, pattern: str, *, modes: set[str], kind: str) -> np.ndarray:
    """Counts (K, H, W) of one to :data:`MOST_VIEWS` different pictures of one size.

    Their names are ``pattern`` with 0 to K - 1 for ``{}``.

    ``modes`` and ``kind`` are those of :func:`read_picture`.
    """
    files = numbered(folder, pattern)
    return join_views(folder, [file.name for file in files],
                      [read_picture(file, modes=modes, kind=kind) for file in files])


def numbered(folder: Path, pattern: str) -> list[Path]:
    """The files of one to :data:`MOST_VIEWS` views, ``pattern`` with 0 to K - 1 for ``{}``."""
    shape = re.compile(re.escape(pattern).replace(r"\{\}", r"\d+"))
    found = {file.name for file in folder.iterdir() if shape.fullmatch(file.name)}
    if not found:
        raise InputError(f"{folder}: {pattern.format(0)} is missing; a capture has one to "
                         f"{MOST_VIEWS} views, {pattern.format(0)} and so on")
    if len(found) > MOST_VIEWS:
        raise InputError(f"{folder} has {len(found)} views; a capture has at most {MOST_VIEWS}")
    expected = [pattern.format(k) for k in range(len(found))]
    for name in expected:
        if name not in found:
            raise InputError(f"{folder}: {name} is missing, but {max(found)} is there; number the "
                             "views from 0 on")
    return [folder / name for name in expected]


def join_views(folder: Path, names: list[str], pictures: list[np.ndarray]) -> np.ndarray:
    """Pictures (K, H, W) of one size, no two of which are the same; ``names`` for messages."""
    for name, picture in zip(names, pictures, strict=True):
        if picture.shape != pictures[0].shape:
            sizes = [f"{p.shape[1]}x{p.shape[0]}" for p in (picture, pictures[0])]
            raise InputError(
                f"{folder}: {name} has {sizes[0]} pixels but {names[0]} has {sizes[1]}; "
                "all views must have one size"
            )
    for (first, a), (second, b) in itertools.combinations(zip(names, pictures, strict=True), 2):
        # Blank pictures are reported by the reader.
        if np.array_equal(a, b) and a.min() < a.max():
            raise InputError(f"{folder}: {first} and {second} are the same picture; each view must "
                             "be taken after the table has turned on")
    return np.stack(pictures)


def median_depth(frames: np.ndarray) -> np.ndarray:
    """Median (H, W) float32 of frames (N, H, W), pixel by pixel, of those that saw something."""
    ordered = np.sort(np.where(frames > 0, frames, np.inf).astype(np.float32), axis=0)
    seen = (frames > 0).sum(axis=0)
    low, high = np.maximum(seen - 1, 0) // 2, seen // 2
    high = np.minimum(high, len(frames) - 1)
    middle = [np.take_along_axis(ordered, at[None], axis=0)[0] for at in (low, high)]
    with np.errstate(invalid="ignore"):
        return np.where(seen > 0, (middle[0] + middle[1]) / 2, np.float32(0.0))


def require_size(what: str | Path, width: int, height: int) -> None:
    """InputError for pictures, called ``what``, of a size that no view can have."""
    if not (SMALLEST_PICTURE[0] <= width <= LARGEST_PICTURE[0]
            and SMALLEST_PICTURE[1] <= height <= LARGEST_PICTURE[1]):
        raise InputError(
            f"{what}: wrong size, {width}x{height} pixels; views have from "
            f"{SMALLEST_PICTURE[0]}x{SMALLEST_PICTURE[1]} to "
            f"{LARGEST_PICTURE[0]}x{LARGEST_PICTURE[1]}")
