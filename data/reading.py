"""Guarded reading of what a user gives: every fault becomes an InputError of one line."""

import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import yaml
from PIL import Image, UnidentifiedImageError

from sim.errors import InputError

SMALLEST_PICTURE = (80, 60)
LARGEST_PICTURE = (4096, 4096)
LARGEST_TEXT = 65536  # bytes


def read_picture(file: Path, *, modes: set[str], kind: str) -> np.ndarray:
    """Counts (H, W) of a PNG whose Pillow mode is one of ``modes``, called ``kind`` in messages."""
    try:
        with Image.open(file, formats=["PNG"]) as picture:
            width, height = picture.size
            bounds = (SMALLEST_PICTURE[0] <= width <= LARGEST_PICTURE[0]) and (
                SMALLEST_PICTURE[1] <= height <= LARGEST_PICTURE[1]
            )
            if not bounds:
                raise InputError(
                    f"{file}: wrong size, {width}x{height} pixels; views have from "
                    f"{SMALLEST_PICTURE[0]}x{SMALLEST_PICTURE[1]} to "
                    f"{LARGEST_PICTURE[0]}x{LARGEST_PICTURE[1]}"
                )
            if picture.mode not in modes:
                raise InputError(f"{file}: picture of kind {picture.mode}; it must be {kind}")
            return np.array(picture)
    except InputError:
        raise
    except UnidentifiedImageError:
        raise InputError(f"{file} is not a PNG picture; export the view again") from None
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
        cause = one_line(error)
        raise InputError(f"{file} cannot be read ({cause}); export the view again") from None


def read_text(file: Path) -> str:
    """A short text file in UTF-8."""
    try:
        if file.stat().st_size > LARGEST_TEXT:
            raise InputError(f"{file} is larger than {LARGEST_TEXT} bytes; not a description")
        return file.read_text(encoding="utf-8")
    except UnicodeDecodeError:
        raise InputError(f"{file} is not text in UTF-8; save it as such") from None
    except OSError as error:
        raise InputError(f"{file} cannot be read ({one_line(error)})") from None


def read_mapping(file: Path) -> Mapping:
    """A YAML file of ``key: value`` lines."""
    text = read_text(file)
    try:
        content = yaml.safe_load(text)
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise InputError(f"{file} is not valid YAML ({one_line(error)})") from None
    if not isinstance(content, Mapping):
        raise InputError(f"{file} must hold 'key: value' lines, such as 'density_g_m2: 150'")
    return content


def finite_number(value: object, what: str) -> float:
    """``value`` as a float; neither text nor a truth value nor NaN nor infinite."""
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
        raise InputError(f"{what}={value!r} is not a finite number")
    return float(value)


def one_line(error: Exception) -> str:
    """An error's message without line breaks, cut short."""
    return " ".join(str(error).split())[:200]
