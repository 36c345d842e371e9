"""A strip's deflection curve from its photograph, with the covariance of its errors.

    picture -> scale -> centre line -> curve from the clamp, in the true horizontal and vertical

From a finite distance a strip is seen as a band between its near and its far edge. Half way between
them lies the middle of its width, in whose plane the scale holds.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from scipy.special import erf

from common.errors import InputError, of
from common.files import path_named
from common.findings import Finding
from common.types import DeflectionCurve, Metres, Pixels, Radians
from data.captures.scale import board_plane
from data.pictures.planes import mapped
from data.pictures.reading import read_photograph
from drapenet.measured.strips.centre_line import CentreLine, trace_strip
from drapenet.measured.strips.description import StripEntry, StripsDescription, View
from drapenet.measured.strips.posterior import MeasuredStrip
from sim.cantilever.moduli import arc_lengths

WORKING_SIDE = 2600  # pixels, to which larger photographs are reduced
BRIGHTEST = 0.9995  # quantile; a strip may be the only light thing in the picture
CLAMP_THICKNESS = 8e-3  # m; thicker than any strip as seen, and thinner than any clamp
STRIP_SHARE = 0.5  # of the picture's larger side, a strip's length where it gives the scale
DISTANCE = 0.8  # m, of a camera whose distance is not stated
MAX_BAND, MAX_PIXEL = 5e-3, 3e-4  # m
MAX_LENGTH_DIFFERENCE = (0.04, 1.5e-3)  # relative, and m, from the stated free length
MAX_START = np.radians(25.0)  # between clamp and the start of the strip
MAX_RISE = np.radians(25.0)  # of a strip's end from its steepest part
MAX_HANG = np.radians(100.0)  # below the horizontal

LENGTH_ERROR = 5e-4  # m, of a free length; all errors are standard deviations
SCALE_ERROR = {"mm_per_px": 5e-3, "ruler_px": 5e-3, "board": 3e-3}
POINT_ERROR = 1.0  # pixels, of each end of a ruler
TILT, BOARD_TILT = np.radians(1.5), np.radians(0.3)
"""Of the camera from the view along the strip's width, and of a board from the strip's plane."""
ROLL_ERROR, UNKNOWN_ROLL = np.radians(0.3), np.radians(2.0)
CLAMP_ERROR = 1.5e-4  # m, of the clamp's edge and of a tip, without perspective
READING_ERROR = 1e-5  # m, of each point
END_ERROR = 0.025  # relative to the band's width, of the points within a width of an end
EXPECTED_BAND, EXPECTED_PIXEL = 1.5e-3, 5e-5  # m, of a good photograph
BAND_ERROR = (5e-6, 0.008)  # m, and relative to the band's width, over a quarter of a strip


@dataclass(frozen=True)
class PhotographedStrip:
    """One strip, and what was seen of it."""

    name: str  # of the file
    direction: str
    measured: MeasuredStrip
    picture: np.ndarray  # (H, W) uint8, grey, reduced
    pixels: Pixels  # of the curve in the picture
    band: Metres  # width of the strip as seen
    warnings: tuple[Finding, ...] = ()


def read_strip(
    folder: Path, entry: StripEntry, description: StripsDescription, *, slope: Radians
) -> PhotographedStrip:
    """Read the photograph of an entry; InputError if it does not show a hanging strip.

    ``slope``: of the clamp below the horizontal, rad.
    """
    assert entry.file and entry.free_length_mm  # of an entry with a photograph
    file = path_named(folder, entry.file)
    with of(file):
        return _read(file, entry, 1e-3 * entry.free_length_mm, description, slope)


def _read(
    file: Path, entry: StripEntry, length: Metres, description: StripsDescription, slope: Radians
) -> PhotographedStrip:
    view = description.view(entry)
    if view.scale is None:
        raise InputError("scale is missing; give scale: {mm_per_px: 0.05}, a ruler, or {by: board}"
                         " (docs/use.md)")
    photograph = read_photograph(file, side=WORKING_SIDE, brightest=BRIGHTEST)
    grey, factor = photograph.grey, photograph.factor
    to_metres, shown, scale_error = _scale(grey, factor, view)
    left = view.hangs == "left"
    line = _trace(shown, grey != shown, view, factor, slope, left, length, to_metres)
    pixels = np.vstack([line.clamp, line.points])
    roll, roll_error, warnings = _horizontal(line, view, left)
    if to_metres is None:
        seen = float(np.linalg.norm(np.diff(pixels, axis=0), axis=1).sum())
        to_metres = np.diag([1.0, 1.0, seen / length])
    if left:
        pixels = pixels * [-1, 1] + [grey.shape[1] - 1, 0]
    # The true horizontal, in the plane of the strip, points from the clamp to the strip's side.
    side = -1.0 if left else 1.0
    ahead = pixels[0] + side * np.array([np.cos(roll), side * np.sin(roll)])
    places = mapped(np.vstack([pixels, ahead, _middle(grey)]), to_metres)
    out = (places[-2] - places[0]) / np.linalg.norm(places[-2] - places[0])
    below = mapped(pixels[:1] + np.array([0, 1]), to_metres)[0] - places[0]
    down = below - (below @ out) * out
    axes = np.stack([out, down / np.linalg.norm(down)])
    curve = (places[:-2] - places[0]) @ axes.T
    aim = (places[-1] - places[0]) @ axes.T
    pixel = float(np.linalg.norm(curve[-1]) / np.linalg.norm(pixels[-1] - pixels[0]))
    distance = 1e-3 * view.camera_distance_mm if view.camera_distance_mm else DISTANCE
    width = 1e-3 * description.width_mm
    shares = (line.band, description.thickness / pixel if description.thickness else line.thinnest)
    curve, edge_error = _true_edge(curve, aim, distance, 1e-3 * description.clamp_width_mm)
    curve, tip_error = _true_tip(curve, aim, distance, width, shares, view)
    by_length = view.scale.by == "free_length"
    arc = float(np.linalg.norm(np.diff(curve, axis=0), axis=1).sum())
    if by_length:
        curve, scale_error = curve * length / arc, float(
            np.linalg.norm([LENGTH_ERROR, tip_error, edge_error]) / length)
    else:
        _require_length(arc, length)
    _require_hanging(curve, slope)
    band = line.band * pixel
    warnings += _doubts(line, view, pixel / factor, band, pixel, description)
    covariance = _covariance(
        curve, pixel * line.error, band, aim, distance, scale=scale_error, roll=roll_error,
        tip=tip_error, edge=edge_error, pixel=pixel,
        tilt=BOARD_TILT if view.scale.by == "board" else TILT)
    measured = MeasuredStrip(curve, covariance, length, np.inf if by_length else LENGTH_ERROR,
                             entry.sign, entry.specimen)
    return PhotographedStrip(
        file.name, entry.direction, measured, grey.astype(np.uint8), pixels, band,
        tuple(replace(found, values={"file": file.name, **found.values}) for found in warnings))


def expected_strip(curve: DeflectionCurve, length: Metres, *, sign: int) -> MeasuredStrip:
    """What a good photograph of a strip with this curve gives: of a stated scale and a level
    clamp, from :data:`DISTANCE`."""
    covariance = _covariance(
        curve, np.full(len(curve), READING_ERROR), EXPECTED_BAND, curve.mean(axis=0), DISTANCE,
        scale=SCALE_ERROR["mm_per_px"], roll=ROLL_ERROR, tip=CLAMP_ERROR, edge=CLAMP_ERROR,
        pixel=EXPECTED_PIXEL, tilt=TILT)
    return MeasuredStrip(curve, covariance, length, LENGTH_ERROR, sign)


def _scale(
    grey: np.ndarray, factor: int, view: View
) -> tuple[np.ndarray | None, np.ndarray, float]:
    """Homography from pixels to the plane of the strip, m, None if its length is the scale; the
    picture, in which a board is painted over; and the scale's relative error."""
    scale = view.scale
    assert scale  # stated, or checked where it is left out
    if scale.by == "free_length":
        return None, grey, np.nan
    if scale.by == "board":
        if (plane := board_plane(grey)) is None:
            raise InputError("the printed board is not seen; place it beside the strip, in the "
                             "plane of the middle of its width, or give another scale")
        to_metres, board = plane
        around = cv2.dilate(board.astype(np.uint8), np.ones((15, 15), np.uint8)) > 0
        painted = np.where(board, np.median(grey[around & ~board]), grey).astype(np.float32)
        return to_metres, painted, SCALE_ERROR["board"]
    if scale.mm_per_px:
        pixel, error = 1e-3 * scale.mm_per_px, SCALE_ERROR["mm_per_px"]
    else:
        assert scale.ruler_px and scale.ruler_mm
        start, end = np.array(scale.ruler_px)
        pixels = float(np.linalg.norm(end - start))
        pixel = 1e-3 * scale.ruler_mm / pixels
        error = float(np.hypot(SCALE_ERROR["ruler_px"], POINT_ERROR * np.sqrt(2) / pixels))
    return np.diag([pixel * factor, pixel * factor, 1.0]), grey, error


def _trace(
    picture: np.ndarray, ignored: np.ndarray, view: View, factor: int, slope: Radians, left: bool,
    length: Metres, to_metres: np.ndarray | None
) -> CentreLine:
    """The centre line of the strip, mirrored if it hangs to the ``left``."""
    clamp = None
    if view.clamp_px:
        clamp = (np.array(view.clamp_px) + 0.5) / factor - 0.5
        if not ((clamp >= 0) & (clamp < picture.shape[::-1])).all():
            raise InputError(f"clamp_px={view.clamp_px} is not in the picture; give its column and "
                             "row in pixels of the file")
        clamp = clamp * [-1, 1] + [picture.shape[1] - 1, 0] if left else clamp
    roll = None if view.roll_deg is None else (-1 if left else 1) * np.radians(view.roll_deg)
    if to_metres is None:
        thick = CLAMP_THICKNESS / 2 * STRIP_SHARE * max(picture.shape) / length
    else:
        middle = _middle(picture)
        here, beside = mapped(middle + np.array([[0, 0], [1, 0]]), to_metres)
        thick = CLAMP_THICKNESS / 2 / float(np.linalg.norm(beside - here))
        if 2 * thick * length / CLAMP_THICKNESS > 1.5 * np.hypot(*picture.shape):
            raise InputError(f"the free length of {1e3 * length:g} mm is larger than the picture "
                             "at this scale; check the scale")
    if left:
        picture, ignored = picture[:, ::-1], ignored[:, ::-1]
    return trace_strip(np.ascontiguousarray(picture), np.ascontiguousarray(ignored), thick=thick,
                       clamp=clamp, roll=roll, slope=slope)


def _horizontal(
    line: CentreLine, view: View, left: bool
) -> tuple[Radians, Radians, list[Finding]]:
    """Roll of the true horizontal in the picture as traced, its error, and warnings."""
    if view.roll_deg is not None:
        return (-1 if left else 1) * np.radians(view.roll_deg), ROLL_ERROR, []
    if np.isnan(line.roll):
        return 0.0, UNKNOWN_ROLL, [Finding("strip_not_level")]
    return line.roll, ROLL_ERROR, []


def _middle(picture: np.ndarray) -> np.ndarray:
    return (np.array(picture.shape[::-1]) - 1) / 2


def _true_edge(
    curve: DeflectionCurve, aim: np.ndarray, distance: Metres, clamp_width: Metres
) -> tuple[DeflectionCurve, Metres]:
    """The curve from the clamp's edge in the middle of its width, and the error of that edge.

    The edge that is seen is the outermost one, near or far: where the camera is not exactly beside
    it, always outwards. The camera's inclination is not known, so that the mean of what it hides
    is added, and its deviation is part of the error.
    """
    half = clamp_width / 2
    mean, spread = half * abs(float(aim[0])) / distance, half * TILT
    # Mean and deviation of the folded normal distribution (Leone et al. 1961).
    hidden = float(np.sqrt(2 / np.pi) * spread * np.exp(-((mean / spread) ** 2) / 2)
                   + mean * erf(mean / spread / np.sqrt(2)))
    moved = curve + np.array([hidden, 0.0])
    moved[0] = 0.0
    unsure = float(np.sqrt(mean**2 + spread**2 - hidden**2))
    return moved, float(np.hypot(CLAMP_ERROR, unsure))


def _true_tip(
    curve: DeflectionCurve, aim: np.ndarray, distance: Metres, width: Metres,
    shares: tuple[float, float], view: View
) -> tuple[DeflectionCurve, Metres]:
    """The curve, shortened by how much the near or far corner of its tip is seen beyond the middle
    of its width, and the tip's error. ``shares``: the strip's width as seen, and its thickness; on
    a strip seen wide the middle of its end is seen."""
    along = curve[-1] - curve[-4]
    along = along / np.linalg.norm(along)
    seen, thickness = shares
    hidden = min(1.0, thickness / max(seen - thickness, 1e-6))
    beyond = hidden * width / 2 / distance * abs(float((curve[-1] - aim) @ along))
    end = curve[-1] - beyond * along
    kept = curve[(curve - end) @ along < -1e-6]
    tilt = hidden * width / 2 * TILT
    unsure = 0.0 if view.camera_distance_mm else 0.4 * beyond
    return np.vstack([kept, end]), float(np.linalg.norm([CLAMP_ERROR, tilt, unsure]))


def _covariance(
    curve: DeflectionCurve, reading: np.ndarray, band: Metres, aim: np.ndarray, distance: Metres,
    *, scale: float, roll: Radians, tip: Metres, edge: Metres, tilt: Radians, pixel: Metres
) -> np.ndarray:
    """Covariance (2 N, 2 N) of a curve whose first point is 0 by definition; arguments are the
    standard deviations of its errors."""
    x, y = curve.T
    moved = np.arange(len(curve)) > 0
    modes = [scale * curve, roll * np.column_stack([-y, x])]
    modes += [np.outer(moved, shift) for shift in ([edge, 0], [0, CLAMP_ERROR / 4 + pixel / 2])]
    from_aim = curve - aim
    for axis in np.eye(2):  # the scale changes along the picture of an inclined plane
        seen = from_aim * (from_aim @ axis)[:, None]
        modes.append(tilt / distance * (seen - seen[0]))
    along = curve[-1] - curve[-4]
    end = np.zeros_like(curve)
    end[-1] = tip * along / np.linalg.norm(along)
    flat = np.stack([mode.ravel() for mode in [*modes, end]])
    arc = arc_lengths(curve)
    apart = (arc[:, None] - arc) / (arc[-1] / 4)
    size = BAND_ERROR[0] + BAND_ERROR[1] * band
    # Near its ends a band is cut obliquely, or hidden by the clamp.
    ends = np.exp(-(arc - arc[1]) / band) + np.exp(-(arc[-1] - arc) / band)
    own = np.append(0.0, np.hypot(reading, READING_ERROR))[: len(curve)] ** 2
    own += moved * (END_ERROR * band * ends) ** 2
    common = moved[:, None] * moved * size**2 * np.exp(-0.5 * apart**2) + np.diag(own)
    return flat.T @ flat + np.kron(common, np.eye(2))


def _require_length(arc: Metres, length: Metres) -> None:
    relative, absolute = MAX_LENGTH_DIFFERENCE
    if abs(arc - length) > relative * length + absolute:
        raise InputError(f"the strip is {1e3 * arc:.1f} mm long from clamp to tip, but "
                         f"free_length_mm states {1e3 * length:g}, which differs by more than "
                         f"{relative:.0%} and {1e3 * absolute:g} mm; check the scale, the clamp's "
                         "place and the length")


def _require_hanging(curve: DeflectionCurve, slope: Radians) -> None:
    """InputError for a curve that is not of a strip hanging from a clamp."""
    steps = np.diff(curve[:: max(1, len(curve) // 15)], axis=0)
    heading = np.unwrap(np.arctan2(steps[:, 1], steps[:, 0]))
    if curve[-1, 0] <= 0 or curve[-1, 1] <= 0:
        raise InputError(f"the tip is at ({1e3 * curve[-1, 0]:.1f}, {-1e3 * curve[-1, 1]:.1f}) mm "
                         "from the clamp, it must lie beside and below it; check that the picture "
                         "is upright, and the side to which the strip hangs")
    middles = np.arange(0.5, 4)
    start = np.polyfit(middles, heading[:4], 2)[-1]  # extrapolated, because cloth bends most here
    if abs(start - slope) > MAX_START:
        raise InputError(f"the strip leaves the clamp at {np.degrees(start):.0f}° below the "
                         f"horizontal, the clamp has {np.degrees(slope):.0f}°; level the clamp, "
                         "press the strip flat, and check roll_deg and the clamp's place")
    if heading.max() - heading[-1] > MAX_RISE:
        raise InputError(f"the strip's end is {np.degrees(heading.max() - heading[-1]):.0f}° less "
                         "steep than the strip above it; it curls: use a longer strip, or a drape")
    if heading.max() > MAX_HANG:
        raise InputError(f"the strip hangs at {np.degrees(heading.max()):.0f}°, beyond the "
                         "vertical; it curls, or something touches it")


def _doubts(
    line: CentreLine, view: View, file_pixel: Metres, band: Metres, pixel: Metres,
    description: StripsDescription
) -> list[Finding]:
    """Warnings of a strip that is read all the same."""
    width, found = 1e3 * float(band), []
    if file_pixel > MAX_PIXEL:
        found.append(Finding("strip_pixel_large", {"value": 1e3 * float(file_pixel),
                                                   "limit": 1e3 * MAX_PIXEL}))
    if band > MAX_BAND:
        found.append(Finding("strip_wide", {"value": width, "limit": 1e3 * MAX_BAND}))
    if description.thickness and band < 0.5 * description.thickness - 2 * pixel:
        found.append(Finding("strip_thin", {"value": width,
                                            "thickness": description.thickness_mm}))
    if line.uneven is not None and line.uneven * pixel > 2e-3:
        found.append(Finding("clamp_uneven", {"value": 1e3 * float(line.uneven * pixel)}))
    if view.camera_distance_mm is None:
        found.append(Finding("camera_distance_missing", {"taken": 1e3 * DISTANCE}))
    return found
