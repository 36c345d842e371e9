"""The extension of a strip under a weight by two photographs over the printed mat.

In the plane of the strip, whose place in both pictures the markers of the mat give, the strip is
the band of its width that differs from the mat's ground, and the marks are lines across it. Each
mark is measured in columns along the strip. The extension is the difference of the two pictures'
distances in each column, so that the shapes of lines that are drawn by hand cancel. Distances are
those across the lines, as far as these are straight.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from common.errors import InputError, of
from common.files import path_named
from common.types import Metres, Pixels, Radians
from data.captures.scale import MAT_SIDE
from data.pictures.mat import MATS, QUIET, find_mat, on_ground
from data.pictures.planes import behind, mapped
from data.pictures.pose import PRINT, SEEN, Pose, camera_poses
from data.pictures.reading import Photograph, read_photograph
from drapenet.measured.tension.marks import ACROSS, COLUMNS, STEP, Band, Line, alike, pairs

ABOVE_ERROR = (3e-4, 0.1)
"""Errors of the strip's height above the mat: m, in each picture, and relative, in both alike."""
FLOOR = 5e-5  # m, least error of an extension
_POSE = 1.5  # times the error of a scale alone, as tilt and lens are unknown, too
_YARNS = 2.5e-3  # m, of a line's course across the strip that is one reading
_LIGHT_FLOOR = 0.01  # of light, below which noise rules
_COARSE = 1e-3  # m, of the picture in which the strip is looked for
_DIFFERS = 0.3  # of log light, from the mat
_SCALES = (0.8, 0.5, 0.3, 0.2, 0.15, 0.1, 0.1, 0.1)  # of log light, rounds of the ground's fit
_ANGLES = np.radians(np.arange(0, 180, 1.5))
_FINER = np.radians(np.arange(-1.5, 1.51, 0.25))
_LONG = 40  # points along the strip, at least
_BESIDE = (1.5, 8.0)  # mm beside the strip, where the ground must be seen
_SCORE = 0.25  # of the share of the strip that differs, less that beside it
_WIDTHS = (1.02, 0.98, 0.94, 0.9, 0.85, 0.8, 0.72)  # seen, over that of the cut strip
_GAUGE = (0.06, 3e-3)  # relative and m, by which the marks' distance may differ from the nominal
_RIVAL = 0.75  # of the best pair's strength, beyond which another one is as likely
_SAME = 1e-3  # m, by which two pairs give the same extension
_LEAST_COLUMNS = COLUMNS // 3
OTHERWISE = "or state marks_px, the two marks' places in both pictures"


@dataclass(frozen=True)
class MarkedPicture:
    """A photograph of a strip, in its plane."""

    name: str  # of the file
    photograph: Photograph
    pose: Pose  # of the camera over the mat
    height: Metres  # of the strip above the mat, in lengths of the mat's layout
    markers: np.ndarray  # (M, 2) m, of the mat that are seen
    mat: str  # its name

    @property
    def away(self) -> Metres:
        """Distance of the camera from the strip's plane."""
        return float(self.pose.place[2] - self.height)

    @property
    def scale_error(self) -> float:
        """Relative error of lengths in the mat's plane, by the errors of its markers."""
        spread = np.sqrt(np.square(self.markers - self.markers.mean(axis=0)).mean())
        pixel = self.pose.place[2] / self.pose.focal
        return float(_POSE * np.hypot(SEEN * pixel, PRINT) / (
            spread * np.sqrt(2 * len(self.markers))))

    def logs(self, places: np.ndarray) -> np.ndarray:
        """Logarithm (H, W, 3) of light at places (H, W, 2) of the strip's plane; NaN outside."""
        points = np.dstack([places, np.full(places.shape[:2], self.height)])
        pixels = self.pose.pixels_of(points.reshape(-1, 3)).astype(np.float32)
        columns, rows = (pixels[:, k].reshape(places.shape[:2]) for k in (0, 1))
        light = cv2.remap(self.photograph.light, columns, rows, cv2.INTER_LINEAR,
                          borderMode=cv2.BORDER_CONSTANT, borderValue=(np.nan,) * 3)
        return np.log(np.maximum(light, 0) + _LIGHT_FLOOR)

    def places_of(self, pixels: Pixels) -> np.ndarray:
        """Places (N, 2) of the strip's plane that are seen in pixels (N, 2)."""
        corners = 0.1 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1.0]])
        found = np.zeros((len(pixels), 2))
        for _ in range(20):  # the lens bends little, so that a homography leads to the place
            seen = self.pose.pixels_of(np.column_stack([found, np.full(len(found), self.height)]))
            there = self.pose.pixels_of(np.column_stack([corners, np.full(4, self.height)]))
            back = cv2.getPerspectiveTransform(there.astype(np.float32), corners.astype(np.float32))
            found = found + mapped(pixels, back) - mapped(seen, back)
        return found


@dataclass(frozen=True)
class Strip:
    """A strip in its plane."""

    middle: np.ndarray  # (2,) a point of its middle line
    along: np.ndarray  # (2,) its direction
    width: Metres
    ends: tuple[Metres, Metres]  # places along it, from that point, between which it may be

    def places(self, along: np.ndarray, across: np.ndarray) -> np.ndarray:
        """Places (..., 2), m, in the plane, by coordinates (...) along and across the strip."""
        normal = np.array([-self.along[1], self.along[0]])
        return self.middle + along[..., None] * self.along + across[..., None] * normal

    def band(self, picture: MarkedPicture) -> Band:
        """The strip, straightened; where there is no picture it is black."""
        count = int((self.ends[1] - self.ends[0]) / STEP)
        along = self.ends[0] + STEP * np.arange(count)
        fine = np.linspace(-ACROSS, ACROSS, 2 * COLUMNS) * self.width
        logs = np.nan_to_num(picture.logs(self.places(along[:, None], fine)),
                             nan=np.log(_LIGHT_FLOOR))
        return Band(along, fine.reshape(COLUMNS, 2).mean(axis=1),
                    logs.reshape(count, COLUMNS, 2, 3).mean(axis=2))


@dataclass(frozen=True)
class PhotographedExtension:
    """What two photographs say, without and with the weight."""

    gauge: Metres  # distance of the marks without the weight
    extension: Metres  # how much farther they are apart with it
    error: Metres  # standard deviation of the extension
    width: Metres  # of the strip without the weight, as seen; NaN if it was not looked for
    turned: Radians  # angle to the strip by which the marks are turned with the weight
    pictures: tuple[MarkedPicture, MarkedPicture]
    courses: np.ndarray  # (2, 2, COLUMNS, 2) pixels, of both marks in both; NaN where not seen


def read_extension(
    folder: Path, files: tuple[str, str], *, width: Metres, gauge: Metres, most: float,
    above: Metres, scale: float, marks: tuple[Sequence, Sequence] | None
) -> PhotographedExtension:
    """Read a pair of photographs, without and with the weight; InputError in one line.

    Args:
        width, gauge: of the cut strip, and nominal, of its marks.
        most: largest relative extension.
        above: height of the strip above the mat.
        scale: lengths on the printed mat over those of its layout.
        marks: two places (2, 2), pixels of the file, in each picture, if they are stated.
    """
    pictures = _pictures([path_named(folder, file) for file in files], above / scale)
    width, gauge = width / scale, gauge / scale
    slack = _GAUGE[0] * gauge + _GAUGE[1]
    windows = ((gauge - slack, gauge + slack), (gauge - slack, (1 + most) * (gauge + slack)))
    seen = []
    for k, picture in enumerate(pictures):
        with of(folder / picture.name):
            seen.append(_look(picture, width, windows[k], scale, marks and marks[k]))
    chosen = _best([one.pairs for one in seen], str(folder / pictures[0].name))
    courses = [[one.band.course(line) for line in pair] for one, pair in zip(
        seen, chosen, strict=True)]
    with of(folder / pictures[1].name):
        distances = _distances([one.band for one in seen], courses, scale)
    length, extension = distances.length, distances.extension
    return PhotographedExtension(
        scale * length, scale * extension,
        scale * _error(pictures, distances, width, above / scale, 1 / scale),
        np.nan if marks else scale * seen[0].strip.width, distances.turned,
        (pictures[0], pictures[1]),
        np.stack([[_pixels(picture, one, course) for course in both]
                  for picture, one, both in zip(pictures, seen, courses, strict=True)]))


@dataclass(frozen=True)
class _Seen:
    """A strip in a picture, and the pairs of lines that may be its marks."""

    strip: Strip
    band: Band
    pairs: list[tuple[Line, Line]]


def _look(picture: MarkedPicture, width: Metres, window: tuple[Metres, Metres], scale: float,
          marks: Sequence | None) -> _Seen:
    """The strip in a picture and its marks, at the places that are stated, or else as lines by one
    pen whose distance is in the ``window``; InputError for none."""
    if marks:
        strip, stated = _stated(picture, marks, width)
        band = strip.band(picture)
        first, second = (band.line_at(place) for place in stated)
        if first and second:
            return _Seen(strip, band, [(first, second)])
        where, otherwise = "at marks_px", ""
    else:
        strip = find_strip(picture, width)
        band = strip.band(picture)
        if found := pairs(band.lines(), *window):
            return _Seen(strip, band, found)
        low, high = (1e3 * scale * end for end in window)
        where, otherwise = f"{low:.0f} to {high:.0f} mm apart, as gauge_mm has it", f", {OTHERWISE}"
    raise InputError(f"no two lines across the strip are seen {where}: draw the marks over the "
                     "whole width with a pen that differs from all colours of the cloth"
                     + otherwise)


@dataclass(frozen=True)
class _Distances:
    """Of two marks."""

    length: Metres  # without the weight
    by_column: np.ndarray  # (COLUMNS,) how much farther they are apart with it
    seen: np.ndarray  # (COLUMNS,) whether a column counts
    turned: Radians  # of the lines between the pictures
    unparallel: Radians  # angle between the lines without the weight

    @property
    def extension(self) -> Metres:
        return float(self.by_column[self.seen].mean())


def _distances(
    bands: Sequence[Band], courses: Sequence[list[np.ndarray]], scale: float
) -> _Distances:
    """By the courses of both marks in both pictures, across the lines; InputError for too few
    columns, or if the marks come nearer."""
    slopes = [_slopes(band, ends) for band, ends in zip(bands, courses, strict=True)]
    apart = [(ends[1] - ends[0]) * np.cos(slope.mean())
             for ends, slope in zip(courses, slopes, strict=True)]
    turned = float(slopes[1].mean() - slopes[0].mean())
    # Nothing tells which way round the strip lies: the lines' shapes do.
    by_column = min((under - apart[0] for under in (apart[1], apart[1][::-1])), key=_spread)
    seen = np.isfinite(by_column)
    for _ in range(3 if seen.sum() >= _LEAST_COLUMNS else 0):
        middle = np.median(by_column[seen])
        seen &= np.abs(by_column - middle) < max(3 * _spread(by_column[seen]), STEP)
    if seen.sum() < _LEAST_COLUMNS:
        raise InputError(f"the marks are seen on {seen.mean():.0%} of the strip's width in both "
                         f"pictures, at least {_LEAST_COLUMNS / COLUMNS:.0%} is needed: draw them "
                         "over the whole width")
    found = _Distances(float(apart[0][seen].mean()), by_column, seen, turned,
                       float(np.diff(slopes[0])[0]))
    if found.extension <= 0:
        raise InputError(
            f"the marks are {1e3 * scale * (found.length + found.extension):.1f} mm apart, without "
            f"the weight {1e3 * scale * found.length:.1f}: are the pictures exchanged, or of other "
            "strips? If nothing is seen, take a heavier weight")
    return found


def _error(pictures: Sequence[MarkedPicture], found: _Distances, width: Metres, above: Metres,
           metre: float) -> Metres:
    """Standard deviation of the extension: by the lines' scatter, the strip's height ``above`` the
    mat, and the markers; ``metre`` is one in lengths of the mat's layout."""
    seen, extension = found.seen, found.extension
    readings = min(float(seen.sum()), 2 * ACROSS * width * seen.mean() / _YARNS)
    lengths = np.array([found.length, found.length + extension])
    away = np.array([one.away for one in pictures])
    alone, both = ABOVE_ERROR[0] * metre / away, ABOVE_ERROR[1] * above / away
    return float(np.linalg.norm([
        FLOOR, found.by_column[seen].std() / np.sqrt(max(readings - 1, 1)), *(lengths * alone),
        np.diff(lengths * both)[0], *(lengths * [one.scale_error for one in pictures]),
        # Lines that are not parallel are measured at other places across an askew band.
        found.turned * found.length / 2 * found.unparallel]))


def _slopes(band: Band, ends: list[np.ndarray]) -> np.ndarray:
    """Angles (2,), rad, of two lines of courses (COLUMNS,) to the normal of a band: of the medians
    over pairs of columns (Theil and Sen), as some are misread; 0 if a line is hardly seen."""
    one, other = np.triu_indices(COLUMNS, COLUMNS // 3)
    run = band.across[other] - band.across[one]
    rises = [(course[other] - course[one]) / run for course in ends]
    return np.arctan([np.nanmedian(rise) if np.isfinite(rise).any() else 0.0 for rise in rises])


def _spread(values: np.ndarray) -> float:
    """Standard deviation of values (N,) by their median, some of which may be NaN."""
    seen = values[np.isfinite(values)]
    return float(1.48 * np.median(np.abs(seen - np.median(seen)))) if len(seen) else np.inf


def _pixels(picture: MarkedPicture, seen: _Seen, course: np.ndarray) -> np.ndarray:
    """Pixels (COLUMNS, 2) of a course."""
    places = seen.strip.places(course, seen.band.across)
    points = np.column_stack([np.nan_to_num(places), np.full(COLUMNS, picture.height)])
    return np.where(np.isfinite(course)[:, None], picture.pose.pixels_of(points), np.nan)


def _pictures(files: list[Path], height: Metres) -> list[MarkedPicture]:
    """Both photographs, with their poses over one mat."""
    photographs, seen, mats = [], [], []
    for file in files:
        photograph = read_photograph(file, side=MAT_SIDE)
        if (found := find_mat(photograph)) is None:
            raise InputError(f"{file}: fewer than six markers of the mat are seen; show the mat "
                             "with its corners, sharp and without glare")
        if found.coded:
            raise InputError(f"{file}: it shows the mat with the code; marks are seen on a plain "
                             f"one: apps.capture mat={found.name} ground=grey")
        mats.append(found.name)
        seen.append(found[2:])
        photographs.append(photograph)
    if mats[0] != mats[1]:
        raise InputError(f"{files[1]}: it shows the mat {mats[1]}, {files[0].name} {mats[0]}; take "
                         "both over one mat")
    first = photographs[0]
    sizes = [one.light.shape[1::-1] for one in photographs]
    poses = []
    try:
        if sorted(sizes[0]) == sorted(sizes[1]) and first.focal == photographs[1].focal:
            poses = camera_poses(sizes, seen, first.focal, first.no_focal)
        else:  # two cameras
            for size, one, photograph in zip(sizes, seen, photographs, strict=True):
                poses += camera_poses([size], [one], photograph.focal, photograph.no_focal)
    except InputError as error:
        if first.focal:
            raise InputError(f"{files[0]}, {files[1].name}: {error}") from None
        raise InputError(f"{files[0]}: the focal length is not known: {first.no_focal}; give the "
                         "file as the camera wrote it, whole and without zoom") from None
    return [MarkedPicture(file.name, photograph, pose, height, points[:, :2], mat)
            for file, photograph, pose, (points, _), mat in zip(
                files, photographs, poses, seen, mats, strict=True)]


def _stated(picture: MarkedPicture, marks: Sequence, width: Metres
            ) -> tuple[Strip, tuple[Metres, Metres]]:
    """The strip between two marks that are stated, and their places along it."""
    pixels = (np.array(marks, float) + 0.5) / picture.photograph.factor - 0.5
    size = np.array(picture.photograph.light.shape[1::-1])
    if not ((pixels >= 0) & (pixels < size)).all():
        raise InputError(f"marks_px={[list(mark) for mark in marks]} is not in the picture; give "
                         "column and row in pixels of the file")
    start, end = picture.places_of(pixels)
    length = float(np.linalg.norm(end - start))
    beyond = 6e-3  # m
    return (Strip((start + end) / 2, (end - start) / length, width,
                  (-length / 2 - beyond, length / 2 + beyond)), (-length / 2, length / 2))


def find_strip(picture: MarkedPicture, width: Metres) -> Strip:
    """The band of about a ``width`` that differs from the mat's ground; InputError for none."""
    half = np.array(MATS[picture.mat].size) / 2
    x, y = (np.arange(-side, side, _COARSE) for side in half)
    places = np.dstack(np.meshgrid(x, y))
    logs = picture.logs(places)
    ground = on_ground(picture.mat, behind(places, picture.pose.place, picture.height))
    ground &= np.isfinite(logs).all(axis=2)
    there = places[ground]
    differs = np.minimum(_from_ground(there / half, logs[ground]) / _DIFFERS, 1)
    best = max(_bands(there, differs, angle, width) for angle in _ANGLES)
    best = max(_bands(there, differs, best[1] + angle, width) for angle in _FINER)
    score, angle, low, high, inside = best
    if score < _SCORE:
        raise InputError(f"no strip of {1e3 * width:g} mm is seen that differs from the mat: print "
                         "the mat with a ground of another colour than the cloth (ground=grey or "
                         f"blue), lay the strip across it so that the mat is seen on both sides, "
                         f"{OTHERWISE}")
    along, normal = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle),
                                                                       np.cos(angle)])
    middle = normal * (low + high) / 2
    ends = _ends(there, differs, along, normal, (low, high), inside)
    # A strip that goes on below the markers ends with the paper, at the latest.
    steep = np.where(np.abs(along) < 1e-6, 1e-6, along)
    borders = np.sort((np.outer([-1, 1], half + QUIET) - middle) / steep, axis=0)
    first, last = borders[0].max(), borders[1].min()
    return Strip(middle, along, high - low, (max(ends[0], first), min(ends[1], last)))


def _from_ground(places: np.ndarray, logs: np.ndarray) -> np.ndarray:
    """Log light (N,) by which logs (N, 3) at places (N, 2) differ from the ground, whose light
    changes smoothly; most of the places, or the most alike of them, are ground."""
    x, y = places.T
    basis = np.column_stack([np.ones(len(x)), x, y, x * x, x * y, y * y])
    fit = np.zeros((6, 3))
    fit[0] = np.median(logs, axis=0)
    away = np.zeros(len(x))
    for scale in _SCALES:
        away = np.sqrt(np.square(logs - basis @ fit).mean(axis=1))
        weight = 1 / (1 + (away / scale) ** 2)  # square root of Geman and McClure's
        fit = np.linalg.lstsq(basis * weight[:, None], logs * weight[:, None], rcond=None)[0]
    return np.sqrt(np.square(logs - basis @ fit).mean(axis=1))


def _bands(places: np.ndarray, differs: np.ndarray, angle: float, width: Metres
           ) -> tuple[float, float, Metres, Metres, float]:
    """Score of the best band along an ``angle``, that angle, the band's borders across it, m, and
    how much it differs."""
    across = places @ np.array([-np.sin(angle), np.cos(angle)])
    first = across.min()
    bins = ((across - first) / _COARSE).astype(int)
    count = np.bincount(bins)
    usable = count >= _LONG
    mean = np.bincount(bins, differs) / np.maximum(count, 1)
    start, stop = (int(np.flatnonzero(usable)[k]) for k in (0, -1))
    total = np.concatenate([[0], np.cumsum(mean[start : stop + 1])])
    near, far = _BESIDE
    best = (-1.0, angle, 0.0, 0.0, 0.0)
    size = len(total) - 1

    def average(low: np.ndarray, high: np.ndarray) -> np.ndarray:
        low, high = (np.rint(one).astype(int).clip(0, size) for one in (low, high))
        return (total[high] - total[low]) / np.maximum(high - low, 1)

    for share in _WIDTHS:
        wide = share * width / _COARSE
        lows = np.arange(far, size - far - wide)
        if not len(lows):
            continue
        inside = average(lows + 1, lows + wide - 1)
        outside = np.maximum(average(lows - far, lows - near),
                             average(lows + wide + near, lows + wide + far))
        k = int((inside - outside).argmax())
        if inside[k] - outside[k] > best[0]:
            low = first + _COARSE * (start + lows[k])
            best = (float(inside[k] - outside[k]), angle, float(low),
                    float(low + _COARSE * wide), float(inside[k]))
    return best


def _ends(places: np.ndarray, differs: np.ndarray, along: np.ndarray, normal: np.ndarray,
          band: tuple[Metres, Metres], inside: float) -> tuple[Metres, Metres]:
    """Between which places along it the ground is covered, m; infinite if it is to its border."""
    across, place = places @ normal, places @ along
    quarter = (band[1] - band[0]) / 4
    mine = (across > band[0] + quarter) & (across < band[1] - quarter)
    first = place.min()
    step = 3 * _COARSE
    bins = ((place[mine] - first) / step).astype(int)
    count = np.bincount(bins)
    mean = np.bincount(bins, differs[mine]) / np.maximum(count, 1)
    covered = (mean > 0.35 * inside) & (count > 0)
    if not covered.any():
        return -np.inf, np.inf
    middle = int(np.median(np.flatnonzero(covered)))
    known = np.flatnonzero(count > 0)
    bare = np.flatnonzero((count > 0) & ~covered)
    below, above = bare[bare < middle], bare[bare > middle]
    # A single bare step may be a colour of the cloth like the ground's.
    low = next((k for k in below[::-1] if not covered[max(k - 3, 0) : k].any()), None)
    high = next((k for k in above if not covered[k + 1 : k + 4].any()), None)
    return (-np.inf if low is None or low < known[0] else first + step * (low + 1),
            np.inf if high is None or high > known[-1] else first + step * high)


def _best(choices: list[list[tuple[Line, Line]]], name: str) -> list[tuple[Line, Line]]:
    """The pairs of lines in both pictures that are most likely the same marks."""
    rated = []
    for without in choices[0]:
        for under in choices[1]:
            strength = min(line.strength for line in (*without, *under))
            same = max(alike(without[0], one) * alike(without[1], other)
                       for one, other in (under, under[::-1]))
            likely = np.sqrt(alike(*without) * alike(*under)) * same**0.25
            extension = (under[1].place - under[0].place) - (without[1].place - without[0].place)
            rated.append((float(strength * likely), extension, [without, under]))
    rated.sort(key=lambda one: -one[0])
    best = rated[0]
    for other in rated[1:]:
        if other[0] > _RIVAL * best[0] and abs(other[1] - best[1]) > _SAME:
            raise InputError(f"{name}: several lines across the strip may be the marks; draw them "
                             f"with a pen that differs from all colours of the cloth, {OTHERWISE}")
    return best[2]
