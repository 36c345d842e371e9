"""Photographs as cameras and phones write them, in linear light."""

import io
import re
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from numbers import Real
from pathlib import Path

import cv2
import numpy as np
import pillow_heif
from PIL import Image, ImageOps, features

from common.documents import read_bytes, reading
from common.errors import InputError
from common.types import ColourPicture, GreyPicture, LinearLight, Mask

MAX_FILE_BYTES = 160 << 20
SIDES = (100, 10_000)  # pixels
WORKING_SIDE = 1500  # pixels, to which larger photographs are reduced
_OF_BROWSERS = tuple(kind for kind in ("WEBP", "AVIF") if features.check(kind.lower()))
FORMATS = ("PNG", "JPEG", "TIFF", "HEIF", *_OF_BROWSERS)
SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".heic", ".heif",
            *(f".{kind.lower()}" for kind in _OF_BROWSERS))
FULL_FRAME = 43.27  # mm, diagonal of the film that equivalent focal lengths refer to
_BRIGHTEST = 0.995  # quantile that a picture is scaled to
_EXIF, _EQUIVALENT_FOCAL, _DIGITAL_ZOOM = 0x8769, 41989, 41988  # tags
_FOCALS, _ZOOMS = (8.0, 400.0), (0.1, 200.0)  # plausible; mm of full frame, and times
_WHOLE = (4 / 3, 3 / 2)  # sides of the sensors of phones and cameras
_PARTS = {330, 50706}  # tags of further pictures, as in raw files, whose first is small
_OF_CAMERAS = {33434, 37386}  # tags: times of exposure, focal lengths
_SCREEN = 96.0  # pixels an inch, which programs write that do not know
_EVEN = 0.01  # relative difference of sides and zooms that counts as none

pillow_heif.register_heif_opener()


@dataclass(frozen=True)
class Photograph:
    """A photograph, reduced.

    Attributes:
        light: proportional to the light of red, green and blue, about 1 for the brightest.
        transparent: pixels that an editor has made transparent, which are not cloth; ``light`` is
            that of the paper or the table on which they would show best.
        missing: where there is no picture; None: nowhere.
        spacing: m between pixels of the file, as a scanner states it; None if none does.
        factor: how many pixels of a row of the file were averaged to each.
        focal: length, pixels of ``light``, as the camera states it; None if it does not, or if the
            picture is not the whole one of which it is stated, for the reason ``no_focal``.
    """

    light: LinearLight
    transparent: Mask
    factor: int = 1
    focal: float | None = None
    no_focal: str = ""
    missing: Mask | None = None
    spacing: float | None = None

    @cached_property
    def colour(self) -> ColourPicture:
        """The picture to look at."""
        return np.rint(255 * encoded(self.light)).astype(np.uint8)

    @cached_property
    def grey(self) -> GreyPicture:
        """Brightness as it is looked at, 0 to 255."""
        return 255 * encoded(cv2.cvtColor(self.light, cv2.COLOR_RGB2GRAY))


def read_photograph(
    file: Path, *, side: int = WORKING_SIDE, brightest: float = _BRIGHTEST
) -> Photograph:
    """Read a photograph, turned upright, with at most ``side`` pixels on a side; the quantile
    ``brightest`` of its light becomes 1."""
    data = read_bytes(file, MAX_FILE_BYTES, "photograph")
    with (reading(file, "save it again as PNG, JPEG, TIFF or HEIC"), _of_bounded_size(),
          warnings.catch_warnings()):
        warnings.simplefilter("ignore", Image.DecompressionBombWarning)  # refused below
        # From memory: of files, Pillow maps some TIFF with the size that they have when turned.
        with Image.open(io.BytesIO(data), formats=FORMATS) as picture:
            width, height = picture.size
            if not SIDES[0] <= min(picture.size) <= max(picture.size) <= SIDES[1]:
                raise InputError(f"{width}x{height} pixels; photographs have {SIDES[0]} to "
                                 f"{SIDES[1]} on each side; save it smaller")
            if picture.format == "TIFF" and (  # one would be chosen unseen
                    picture.n_frames > 1 or _PARTS & picture.tag_v2.keys()):  # type: ignore
                raise InputError("the file holds several pictures, pages or those of a raw file; "
                                 "save the one of the drape as JPEG or PNG")
            (equivalent, no_focal), spacing = _stated_focal(picture), _spacing(picture)
            values, transparent = _values(ImageOps.exif_transpose(picture))
    factor = -(-max(values.shape) // side)
    light = _reduced(values, factor)
    highest = np.maximum(np.maximum(light[..., 0], light[..., 1]), light[..., 2])  # max is slow
    white = max(float(np.quantile(highest, brightest)), 1e-6)
    light = np.minimum(light / white, 1)
    rows, columns = light.shape[:2]
    transparent = transparent[factor // 2 :: factor, factor // 2 :: factor][:rows, :columns]
    if transparent.any() and not transparent.all():
        light[transparent] = 0.0 if np.median(light[~transparent]) > 0.3 else 1.0
    focal = equivalent and equivalent * float(np.hypot(rows, columns)) / FULL_FRAME
    return Photograph(light, transparent, factor, focal, no_focal, spacing=spacing)


@contextmanager
def _of_bounded_size() -> Iterator[None]:
    """A sentence for what Pillow takes for an attack."""
    try:
        yield
    except Image.DecompressionBombError as error:
        counts = re.findall(r"(\d+)\d{6} pixels", str(error))
        raise InputError(f"{''.join(counts[:1])} million pixels; photographs have {SIDES[0]} to "
                         f"{SIDES[1]} on each side; save it smaller") from None


def _stated_focal(picture: Image.Image) -> tuple[float | None, str]:
    """Focal length, mm of full frame, that a file states of its whole picture; else None, and why
    not. Cameras differ in whether a digital zoom is part of it, and a cut leaves it as it was."""
    exif, (width, height) = picture.getexif().get_ifd(_EXIF), picture.size
    equivalent = _plausible(exif.get(_EQUIVALENT_FOCAL), *_FOCALS)
    if not equivalent:
        return None, (f"the file states none between {_FOCALS[0]:g} and {_FOCALS[1]:g} mm "
                      "(messengers remove it)")
    zoom = _plausible(exif.get(_DIGITAL_ZOOM), *_ZOOMS) or 1.0  # 0 and 0/0 are those of none
    shape = max(width / height, height / width)
    if not abs(zoom - 1) < _EVEN:
        return None, f"the picture was taken with a digital zoom of {zoom:.3g}"
    if min(abs(shape / whole - 1) for whole in _WHOLE) > _EVEN:
        return None, (f"the picture of {width}x{height} pixels is cut: its sides are neither 4:3 "
                      "nor 3:2, as those of a whole one")
    return equivalent, ""


def _spacing(picture: Image.Image) -> float | None:
    """Size of a pixel on paper, m, of a scan; InputError for pixels that are not square. Cameras
    and screens state resolutions that mean nothing."""
    across, down = (_plausible(value, 1.0, 1e5) for value in picture.info.get("dpi", (None, None)))
    if not (across and down):
        return None
    if abs(across / down - 1) > _EVEN:
        raise InputError(f"its pixels are not square, {across:.4g} x {down:.4g} an inch; scan with "
                         "one resolution, or resample it")
    camera = _OF_CAMERAS & picture.getexif().get_ifd(_EXIF).keys()
    return None if camera or across <= _SCREEN else 0.0254 / across


def _plausible(value: object, least: float, most: float) -> float | None:
    """The number of a tag of EXIF; None if it is none, as a text or 0/0, or not plausible."""
    number = float(value) if isinstance(value, Real) else 0.0
    return number if least <= number <= most else None


def _values(picture: Image.Image) -> tuple[np.ndarray, np.ndarray]:
    """Values (H, W, C) as encoded, of any type, and which pixels are transparent."""
    if picture.mode[0] in "IF":  # more than 8 bits
        grey = np.nan_to_num(np.asarray(picture, np.float32))
        grey = np.clip(grey / max(float(grey.max()), 1e-6), 0, 1)
        return grey[..., None], np.zeros(grey.shape, bool)
    opaque = picture.convert("RGBA").getchannel("A") if picture.has_transparency_data else None
    if (profile := picture.info.get("icc_profile")) and picture.mode in ("RGB", "RGBA", "CMYK"):
        picture = _in_srgb(picture, profile)
    values = np.asarray(picture.convert("RGB"))
    transparent = np.zeros(values.shape[:2], bool) if opaque is None else np.asarray(opaque) < 128
    return values, transparent


def _in_srgb(picture: Image.Image, profile: bytes) -> Image.Image:
    """The picture in the colours of sRGB; as it is if its profile is damaged."""
    from PIL import ImageCms  # slow to load

    try:
        stated = ImageCms.ImageCmsProfile(io.BytesIO(profile))
        if picture.mode == "RGBA":
            picture = picture.convert("RGB")
        changed = ImageCms.profileToProfile(
            picture, stated, ImageCms.createProfile("sRGB"), outputMode="RGB")
    except (ImageCms.PyCMSError, OSError):
        return picture
    return changed or picture


def _reduced(values: np.ndarray, factor: int) -> LinearLight:
    """Light (H, W, 3) of values as encoded, averaged over squares of ``factor`` pixels."""
    rows, columns = (n // factor for n in values.shape[:2])
    total = np.zeros((rows, columns, values.shape[2]), np.float32)
    table = decoded(np.arange(256, dtype=np.float32) / 255)
    for k in range(factor * factor):
        part = values[k // factor : rows * factor : factor, k % factor : columns * factor : factor]
        total += table[part] if values.dtype == np.uint8 else decoded(part)
    return np.ascontiguousarray(np.broadcast_to(total / factor**2, (rows, columns, 3)))


def decoded(value: np.ndarray) -> np.ndarray:
    """Light (...,), 0 to 1, of values (...,) as sRGB encodes them (IEC 61966-2-1)."""
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4).astype(
        np.float32)


def encoded(light: np.ndarray) -> np.ndarray:
    """Values (...,), 0 to 1, that sRGB encodes light (...,) with."""
    return np.where(light <= 0.0031308, 12.92 * light,
                    1.055 * np.maximum(light, 1e-9) ** (1 / 2.4) - 0.055).astype(np.float32)
