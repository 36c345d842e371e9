"""Outlines of drapes from above, cut out of a photograph or read from a text file, and checked.

    picture -> scale (plate, pixel or board) -> cut-out -> curve in the plane of the plate

Coordinates of pixels are those of their centres, from 0 on.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from common.errors import InputError
from common.types import GreyPicture, Mask, Metres, Outline, Radians
from data.captures.board import MAX_REPROJECTION_ERROR, PAPER, SQUARE, SQUARES, find_corners
from data.captures.description import OUTLINE_TABLES, OutlineSource, PlateInPicture
from data.captures.outline_table import read_closed_curve
from data.pictures.cloth import Place
from data.pictures.edge import outline_of_cloth
from data.pictures.reading import Photograph, read_photograph
from sim.measures import coefficient_of_area, farthest, folds_around
from sim.rig import Rig

MAX_PIXEL = 1.5e-3  # m
MIN_COEFFICIENT = 0.02  # of cloth on a plate; the plate alone has 0
MAX_TILT = np.radians(10.0)
MAX_REACH = 1.03  # over the flat specimen's
MIN_RADIUS = {True: 0.97, False: 0.9}  # over the plate's, by whether its centre is known
MAX_OVERLAP, MAX_DISORDER = 0.03, 0.5  # of azimuth
MAX_GAP = np.radians(15.0)
AZIMUTHS = 720
MAX_SKEW = np.sin(np.radians(2.0))  # a mirrored warp is then at most 2° off, as it is stated
_PERSPECTIVE = (
    "camera_height_mm is missing: from 1 m, a hem 50 mm below the plate looks 6 mm smaller, ten "
    "points of drape coefficient; measure the camera's height above the plate, or state parallel")


@dataclass(frozen=True)
class PhotographedOutline:
    """The outline of a drape from above, as it looks in the plane of the plate.

    Attributes:
        curve: counter-clockwise about the plate's centre if ``centred``, else about its centroid; x
            to the right in the picture, y up.
        height: of the camera above the plate; infinite for parallel light, NaN if unknown.
        picture: (H, W, 3) uint8, reduced; None if the outline is read from a text file.
        to_pixels: (3, 3) homography from the plane of ``curve`` to pixels of ``picture``.
        pixel: size of a pixel of the file at the plate.
    """

    curve: Outline
    height: Metres
    centred: bool
    rig: Rig
    warnings: tuple[str, ...] = ()
    picture: np.ndarray | None = None
    to_pixels: np.ndarray | None = None
    pixel: Metres = np.nan

    @property
    def radii(self) -> np.ndarray:
        """Outermost distances (720,), m, from the origin at equally spaced azimuths from x on."""
        after = np.roll(self.curve, -1, axis=0)
        return farthest(np.stack([self.curve, after], axis=1), AZIMUTHS)

    @property
    def drape_coefficient(self) -> float:
        """Drape coefficient of the area that the curve surrounds, as seen: without perspective."""
        return coefficient_of_area(signed_area(self.curve), self.rig)

    @property
    def folds(self) -> int:
        """Number of folds, as for :func:`sim.measures.fold_angles`."""
        return len(folds_around(self.radii, AZIMUTHS / 120))

    def drawn(self, points: Outline) -> Outline:
        """Points of the plane of ``curve`` in pixels of ``picture``, without one unchanged."""
        return points if self.to_pixels is None else mapped(points, self.to_pixels)


def read_outline(
    file: Path, source: OutlineSource, rig: Rig, warp_direction: Radians | None = None
) -> PhotographedOutline:
    """Read an outline from a photograph or a text file; InputError if it is not of a drape.

    ``warp_direction`` of the cloth, None if it is not marked, is that of its mirror image, too, if
    it lies along x or y.
    """
    is_table = file.suffix.lower() in OUTLINE_TABLES
    others = ("mm_per_px", "plate_px") if is_table else source.OF_TABLES
    if wrong := sorted(source.model_fields_set.intersection(others)):
        kind = "a photograph" if is_table else "a text file"
        raise InputError(f"outline.{wrong[0]} is of {kind}, but the outline is {file.name}; "
                         "leave it out")
    try:
        if is_table:
            handed = warp_direction is not None and abs(np.sin(2 * warp_direction)) > MAX_SKEW
            found = _tabulated(file, source, rig, handed=handed)
        else:
            found = _photographed(file, source, rig)
        warnings = (*found.warnings, *_checked(found))
    except InputError as error:
        raise InputError(str(error) if str(file) in str(error) else f"{file}: {error}") from None
    if np.isnan(source.height):
        warnings += (_PERSPECTIVE,)
    if not found.centred:
        remedy = "give numbers" if is_table else "state plate_px to measure"
        warnings += ("the plate's centre is not known, so that distances are measured from the "
                     f"outline's centroid; {remedy} from the plate's centre",)
    return replace(found, warnings=warnings)


def _tabulated(
    file: Path, source: OutlineSource, rig: Rig, *, handed: bool
) -> PhotographedOutline:
    curve = read_closed_curve(file, source, handed=handed)
    curve = curve[:-1] if np.array_equal(curve[0], curve[-1]) else curve
    return PhotographedOutline(_oriented(curve if source.centred else curve - _centroid(curve)),
                               source.height, source.centred, rig)


def _photographed(file: Path, source: OutlineSource, rig: Rig) -> PhotographedOutline:
    photograph = read_photograph(file)
    to_metres, board = _scale(photograph, source, rig)
    height, width = photograph.grey.shape
    here = np.array([[width, height], [width + 2, height]]) / 2
    pixel = float(np.linalg.norm(np.diff(mapped(here, to_metres), axis=0)))
    middle = _in_reduced(source.plate_px, photograph) if source.plate_px else None
    pixels = outline_of_cloth(photograph, Place(
        rig.plate_radius / pixel, rig.reach / pixel, middle, outside=board))
    to_metres, tilt = upright(to_metres, _centroid(pixels))
    if not source.plate_px:
        to_metres = _shift(-_centroid(mapped(pixels, to_metres))) @ to_metres
    curve = mapped(pixels, to_metres)
    to_pixels = np.linalg.inv(to_metres)
    millimetre = np.diff(mapped(np.array([[0, 0], [1e-3, 0]]), to_pixels), axis=0)
    step = float(1e-3 / (photograph.factor * np.linalg.norm(millimetre)))
    warnings = []
    warnings += large_pixels(step, MAX_PIXEL)
    if tilt > MAX_TILT:
        warnings.append(f"the plate is seen {np.degrees(tilt):.0f}° off the vertical, more than "
                        f"{np.degrees(MAX_TILT):.0f}°; place the camera above its centre")
    return PhotographedOutline(
        _oriented(curve), source.height, source.plate_px is not None, rig, tuple(warnings),
        photograph.colour, to_pixels, float(step))


def _in_reduced(plate: PlateInPicture, photograph: Photograph) -> np.ndarray:
    """The plate's centre (2,) in pixels of the picture as it was reduced."""
    return (np.array([plate.x, plate.y]) + 0.5) / photograph.factor - 0.5


def _scale(
    photograph: Photograph, source: OutlineSource, rig: Rig
) -> tuple[np.ndarray, Mask | None]:
    """Homography from pixels to the plane of the plate, m, about its centre if that is stated, and
    the pixels of a board."""
    if plate := source.plate_px:
        pixel = rig.plate_diameter * photograph.factor / plate.diameter
        return np.diag([pixel, -pixel, 1.0]) @ _shift(-_in_reduced(plate, photograph)), None
    if source.mm_per_px:
        pixel = 1e-3 * source.mm_per_px * photograph.factor
        return np.diag([pixel, -pixel, 1.0]), None
    if (plane := board_plane(photograph.grey)) is None:
        raise InputError("the scale is not known: give outline: {plate_px: {x: 960, y: 540, "
                         "diameter: 700}} or mm_per_px, or lay the board in the plane of the plate")
    return plane


def board_plane(grey: GreyPicture) -> tuple[np.ndarray, Mask] | None:
    """Homography (3, 3) from pixels to the plane of a printed board, m, and the pixels of the
    board; None if it is not seen, InputError if it is not flat."""
    if (corners := find_corners(grey.astype(np.uint8))) is None:
        return None
    points, pixels = corners[0][:, :2].astype(np.float64), corners[1].astype(np.float64)
    to_metres = cv2.findHomography(pixels, points)[0]
    from_board = np.linalg.inv(to_metres)
    error = np.sqrt(np.square(mapped(points, from_board) - pixels).sum(axis=1).mean())
    if error > MAX_REPROJECTION_ERROR:
        raise InputError(f"the board's corners lie {error:.1f} pixels from those of a flat board, "
                         f"at most {MAX_REPROJECTION_ERROR:g} is allowed; glue it to a flat plate, "
                         "and remove the distortion of the lens")
    middle, half = np.array(SQUARES) * SQUARE / 2, np.array(PAPER) / 2 + 5e-3
    page = mapped(middle + half * [[-1, -1], [1, -1], [1, 1], [-1, 1]], from_board)
    mask = cv2.fillConvexPoly(np.zeros(grey.shape, np.uint8), np.rint(page).astype(np.int32), 1) > 0
    if mask.all():
        raise InputError("the board fills the picture; lay it beside the drape")
    return to_metres, mask


def upright(to_metres: np.ndarray, pixel: np.ndarray) -> tuple[np.ndarray, float]:
    """A homography (3, 3) turned such that at a ``pixel`` (2,) x is to the right and y up in the
    picture, and the angle, rad, between line of sight and vertical there, by the ratio of its
    scales."""
    points = mapped(pixel + np.array([[0, 0], [1, 0], [0, 1]]), to_metres)
    right, down = points[1:] - points[0]
    flip = 1.0 if right[0] * down[1] < right[1] * down[0] else -1.0
    cos, sin = right * [1, flip] / np.linalg.norm(right)
    turn = np.array([[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]])
    scales = np.linalg.svd(np.stack([right, down]), compute_uv=False)
    return turn @ np.diag([1, flip, 1]) @ to_metres, float(np.arccos(scales[1] / scales[0]))


def _shift(offset: np.ndarray) -> np.ndarray:
    return np.array([[1, 0, offset[0]], [0, 1, offset[1]], [0, 0, 1]])


def large_pixels(size: Metres, limit: Metres) -> list[str]:
    """One line if a pixel covers more than the ``limit``."""
    if size <= limit:
        return []
    return [f"a pixel covers {1e3 * size:.2g} mm, more than {1e3 * limit:g} mm; take a larger "
            "picture, or move the camera nearer"]


def mapped(points: np.ndarray, homography: np.ndarray) -> np.ndarray:
    """Points (N, 2), m or pixels, mapped by a homography (3, 3)."""
    return cv2.perspectiveTransform(np.asarray(points, np.float64)[:, None], homography)[:, 0]


def _checked(outline: PhotographedOutline) -> list[str]:
    """Warnings; InputError for a curve that cannot be of a drape on this plate."""
    curve, rig = outline.curve, outline.rig
    angle = np.arctan2(curve[:, 1], curve[:, 0])
    steps = (np.diff(angle, append=angle[0]) + np.pi) % (2 * np.pi) - np.pi
    if abs(steps.sum() - 2 * np.pi) > 1:
        raise InputError("the outline does not go once around the plate's centre; check plate_px, "
                         "or centred of a table, or list the points around the plate")
    if (disorder := (np.abs(steps).sum() / (2 * np.pi) - 1) / 2) > MAX_DISORDER:
        raise InputError(f"the outline turns back over {disorder:.0%} of the azimuth, at most "
                         f"{MAX_DISORDER:.0%} is possible; list the points in order")
    if (gap := np.abs(steps).max()) > MAX_GAP:
        raise InputError(f"the outline has a gap of {np.degrees(gap):.0f}° of azimuth, at most "
                         f"{np.degrees(MAX_GAP):.0f}° is allowed; give points all around")
    reach = cv2.minEnclosingCircle(curve.astype(np.float32))[1]
    if reach > MAX_REACH * rig.reach:
        raise InputError(f"the outline fills a circle of {1e3 * reach:.0f} mm radius, more than "
                         f"{MAX_REACH:g} times that of the flat specimen, {1e3 * rig.reach:.0f} mm;"
                         " check the scale, the size of the specimen and the tester")
    nearest, rim = outline.radii.min(), rig.plate_radius
    if nearest < MIN_RADIUS[outline.centred] * rim:
        raise InputError(f"the outline comes within {1e3 * nearest:.1f} mm of the plate's centre, "
                         f"inside the plate of {1e3 * rim:g} mm radius; check the scale, the "
                         "plate's place and the tester")
    if not MIN_COEFFICIENT <= (coefficient := outline.drape_coefficient) <= 1:
        raise InputError(f"the drape coefficient is {coefficient:.1%}, only {MIN_COEFFICIENT:.0%} "
                         "to 100% is possible; check the scale, the size of the specimen, the "
                         "tester, and that the outline is not that of the plate or of a hole")
    return [] if disorder <= MAX_OVERLAP else [
        f"the outline turns back over {disorder:.0%} of the azimuth, more than {MAX_OVERLAP:.0%}; "
        "its outermost point counts: check the picture for shadows of folds"]


def signed_area(curve: Outline) -> float:
    """Area within a closed curve, m²; negative if it runs clockwise."""
    return float(_cross(curve).sum() / 2)


def _oriented(curve: Outline) -> Outline:
    """The curve, counter-clockwise."""
    return curve if signed_area(curve) > 0 else curve[::-1]


def _cross(curve: np.ndarray) -> np.ndarray:
    after = np.roll(curve, -1, axis=0)
    return curve[:, 0] * after[:, 1] - curve[:, 1] * after[:, 0]


def _centroid(curve: np.ndarray) -> np.ndarray:
    """Centroid (2,) of the area within a closed curve (N, 2), in its unit."""
    middle = curve.mean(axis=0)
    cross = _cross(around := curve - middle)
    return middle + (around + np.roll(around, -1, axis=0)).T @ cross / (3 * cross.sum())
