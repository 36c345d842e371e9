"""A printed mat under the plate's stand: its picture, pages to print, and its markers in pictures.

A ring of fiducial markers (AprilTag 36h11) surrounds a plain middle with circles for the foot of
the stand. The plain part may be grey or blue, so that white cloth differs from it. Coordinates are
in the plane of the mat: x along its arrow, y to the left of it, the centre of the circles the
origin, m.
"""

import io
from dataclasses import dataclass
from functools import cache
from typing import Any

import cv2
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from common.errors import InputError
from common.types import Mask, Metres, Pixels, Points
from data.pictures.reading import Photograph, decoded, encoded

DPI = 300
PIXEL = 25.4e-3 / DPI  # m, of the mat's picture
MARKER = 24e-3  # m, side of its black square
MIN_MARKERS = 6
BAR = 200e-3  # m, length of the scale on the mat
CLEAR = 10e-3  # m, of a hem from markers and from the paper's border
_DICTIONARY = cv2.aruco.DICT_APRILTAG_36h11
_DETECTION = {"cornerRefinementMethod": cv2.aruco.CORNER_REFINE_CONTOUR,
              "errorCorrectionRate": 1.0, "perspectiveRemovePixelPerCell": 8,
              "perspectiveRemoveIgnoredMarginPerCell": 0.25}
"""Of blurred and overexposed markers, the middles of the modules are read."""
_CIRCLES = np.arange(30, 91, 10) * 1e-3  # m, radii
GROUNDS = {"white": (255, 255, 255), "grey": (128, 128, 128), "blue": (70, 120, 190)}
"""Colours, sRGB, of the mat around its markers. Grey of 128 reflects 22 % of the light of paper,
about the geometric mean of white cloth (85 %) and black cloth (4 %), so that both differ from it by
a factor of four or five; printers make it of fine dots without stripes. Blue is as dark, for grey
cloth."""
_LINE, _TEXT = 205, 150  # grey of lines and letters on white; as visible on other grounds
QUIET = 5e-3  # m, white, around the markers
_BLUR = 6.0  # pixels, 0.5 mm
_OVERLAP = 2e-3  # m, by which parts on several pages overlap
_PAGES = {"a2": (594, 420), "a3": (420, 297), "tabloid": (431.8, 279.4), "a4": (297, 210),
          "letter": (279.4, 215.9)}
"""Papers, mm, wide and high."""


@dataclass(frozen=True)
class Mat:
    """A mat's layout: width and height, m, number of markers along them, and the first's number."""

    size: tuple[Metres, Metres]
    along: tuple[int, int]
    first: int

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width of its picture, in pixels."""
        width, height = (round((side + 2 * QUIET) / PIXEL) for side in self.size)
        return height, width

    @property
    def numbers(self) -> range:
        """Numbers of the markers."""
        wide, high = self.along
        return range(self.first, self.first + 2 * wide + 2 * (high - 2))

    @property
    def clear(self) -> Metres:
        """Radius about its middle within which hems, as seen on it, stay clear of markers."""
        return min(self.size) / 2 - MARKER - QUIET - CLEAR

    @property
    def centres(self) -> np.ndarray:
        """Centres (M, 2) of the markers, m."""
        x, y = ((side - MARKER) / 2 for side in self.size)
        columns, rows = np.linspace(-x, x, self.along[0]), np.linspace(-y, y, self.along[1])[1:-1]
        return np.array([*((c, y) for c in columns), *((c, -y) for c in columns),
                         *((-x, r) for r in rows), *((x, r) for r in rows)])


MATS = {"a3": Mat((0.396, 0.262), (10, 7), 0), "a2": Mat((0.530, 0.396), (13, 10), 100)}
PARTS = {("a3", "a3"): (1, 1), ("a3", "tabloid"): (1, 1), ("a3", "a4"): (2, 1),
         ("a3", "letter"): (2, 1), ("a2", "a2"): (1, 1), ("a2", "a4"): (2, 2),
         ("a2", "letter"): (2, 2)}
"""Columns and rows of pages, by mat and paper."""


@cache
def mat_picture(name: str, ground: str = "white") -> np.ndarray:
    """The mat (H, W) uint8, grey, :data:`PIXEL` a pixel, its arrow to the right; ``ground``: of
    :data:`GROUNDS`."""
    return np.asarray(_drawn(name, ground).convert("L"))


def mat_colours(name: str, ground: str = "white") -> np.ndarray:
    """The same in colours (H, W, 3) uint8, sRGB."""
    return np.asarray(_drawn(name, ground).convert("RGB"))


def _drawn(name: str, ground: str) -> Image.Image:
    """The mat's picture, grey unless its ground has a colour: a third of the work."""
    mat, colour = MATS[name], np.array(GROUNDS[ground])
    height, width = mat.shape
    grey = len(set(GROUNDS[ground])) == 1

    def ink(tones: np.ndarray) -> Any:
        return int(tones[0]) if grey else tuple(tones.tolist())

    page = Image.new("L" if grey else "RGB", (width, height), ink(colour))
    draw = ImageDraw.Draw(page)
    faint, dark = (ink(np.rint(255 * encoded(
        decoded(np.array(tone / 255)) * decoded(colour / 255))).astype(int))
        for tone in (_LINE, _TEXT))

    def at(x: Metres, y: Metres) -> tuple[float, float]:
        return width / 2 + x / PIXEL, height / 2 - y / PIXEL

    def line(*points: tuple[Metres, Metres], wide: int = 3) -> None:
        draw.line([at(*point) for point in points], fill=faint, width=wide)

    def write(x: Metres, y: Metres, text: str, size: Metres = 3.2e-3) -> None:
        draw.text(at(x, y), text, fill=dark, anchor="mm",
                  font=ImageFont.load_default(size / PIXEL))

    half = MARKER / 2 + QUIET
    for x, y in mat.centres:
        draw.rectangle([*at(x - half, y + half), *at(x + half, y - half)], fill="white")
    for radius in _CIRCLES:
        draw.ellipse([*at(-radius, radius), *at(radius, -radius)], outline=faint, width=3)
        write(0.71 * radius + 5e-3, -0.71 * radius - 2e-3, f"{2e3 * radius:g}", 2.5e-3)
    line((-0.1, 0), (0.1, 0))
    line((0, -0.1), (0, 0.1))
    inner_x, inner_y = (side / 2 - MARKER for side in mat.size)
    tip = inner_x - 4e-3
    line((0.11, 0), (tip, 0), wide=12)
    line((tip - 8e-3, 5e-3), (tip, 0), (tip - 8e-3, -5e-3), wide=12)
    write(tip - 8e-3, 9e-3, "WARP")
    write(0, inner_y - 5e-3, f"mat {name}: print at 100 %, lay flat on a plain table; centre the "
          "foot on the circles, warp along the arrow")
    low = -inner_y + 4e-3
    line((-BAR / 2, low), (BAR / 2, low))
    for tick in np.linspace(-BAR / 2, BAR / 2, 21):
        line((tick, low), (tick, low + 3e-3))
    write(BAR / 2 + 22e-3, low + 1e-3, f"{1e3 * BAR:g} mm: measure it")
    for number, centre in zip(mat.numbers, mat.centres, strict=True):
        side = round(MARKER / PIXEL)
        marker = cv2.aruco.generateImageMarker(
            cv2.aruco.getPredefinedDictionary(_DICTIONARY), number, side)
        left, top = np.rint(np.array(at(*centre)) - side / 2).astype(int)
        page.paste(Image.fromarray(marker), (int(left), int(top)))
    return page


@cache
def _ground(name: str) -> Mask:
    """Where (H, W) a mat shows its ground in the pixels of :func:`mat_picture`, or lines on it; not
    around its markers."""
    return mat_picture(name, "grey") != mat_picture(name)


def on_ground(name: str, places: np.ndarray) -> np.ndarray:
    """Whether (...,) places (..., 2), m, are on a mat, but not on its markers or the white around
    them."""
    height, width = (ground := _ground(name)).shape
    columns, rows = (np.rint(one).astype(int) for one in mat_pixels(name, places))
    on = (columns >= 0) & (rows >= 0) & (columns < width) & (rows < height)
    return on & ground[np.where(on, rows, 0), np.where(on, columns, 0)]


@cache
def _blurred(name: str, ground: str) -> np.ndarray:
    return cv2.GaussianBlur(mat_picture(name, ground), (0, 0), _BLUR)


def printed_at(name: str, places: np.ndarray, ground: str = "white") -> tuple[np.ndarray, Mask]:
    """The print (H, W) uint8 at places (H, W, 2), m, 0 beside the mat, a little blurred, and where
    the mat is."""
    printed = cv2.remap(_blurred(name, ground), *mat_pixels(name, places), cv2.INTER_LINEAR,
                        borderValue=0)
    half = np.array(MATS[name].size) / 2 + QUIET
    return printed, (np.abs(places) < half).all(axis=2)


def mat_pixels(name: str, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Columns and rows (...,) float32, in pixels of :func:`mat_picture`, of places (..., 2), m."""
    height, width = MATS[name].shape
    return ((places[..., 0] / PIXEL + (width - 1) / 2).astype(np.float32),
            (-places[..., 1] / PIXEL + (height - 1) / 2).astype(np.float32))


def along_border(name: str, places: np.ndarray) -> np.ndarray:
    """Whether places (N, 2), m, on a mat lie within :data:`CLEAR` of the border of its paper."""
    outside = np.abs(places) - np.array(MATS[name].size) / 2 - QUIET
    return np.abs(outside.max(axis=1)) < CLEAR


def on_paper(name: str, places: np.ndarray) -> np.ndarray:
    """Whether places (N, 2), m, are on a mat's paper."""
    return (np.abs(places) < np.array(MATS[name].size) / 2 + QUIET).all(axis=1)


def near_markers(name: str, places: np.ndarray, within: Metres = CLEAR) -> np.ndarray:
    """Whether places (N, 2), m, are on markers of a mat or ``within`` a distance of them."""
    apart = np.abs(places[:, None] - MATS[name].centres).max(axis=2)
    return apart.min(axis=1) < MARKER / 2 + within


def mat_pages(name: str, paper: str, ground: str = "white") -> bytes:
    """PDF of a mat, in as many pages as it needs on a paper; to be printed at 100 %."""
    from fpdf import FPDF

    if (name, paper) not in PARTS:
        choices = ", ".join(f"mat={one} paper={other}" for one, other in PARTS)
        raise InputError(f"mat={name} paper={paper} does not fit; choose {choices}")
    if ground not in GROUNDS:
        raise InputError(f"ground={ground} is no colour of a mat; choose {', '.join(GROUNDS)}")
    columns, rows = PARTS[name, paper]
    picture = mat_colours(name, ground)
    extra = round(_OVERLAP / PIXEL)
    wide, high = picture.shape[1] // columns, picture.shape[0] // rows
    sheet = max(_PAGES[paper]), min(_PAGES[paper])
    if wide < high:
        sheet = sheet[::-1]
    pages = FPDF(unit="mm", format=sheet)
    pages.set_auto_page_break(False)
    for row in range(rows):
        for column in range(columns):
            top, left = max(row * high - extra, 0), max(column * wide - extra, 0)
            part = picture[top : (row + 1) * high + extra, left : (column + 1) * wide + extra]
            size = [1e3 * PIXEL * n for n in part.shape[1::-1]]
            x, y = ((outer - inner) / 2 for outer, inner in zip(sheet, size, strict=True))
            pages.add_page()
            stream = io.BytesIO()
            Image.fromarray(part).save(stream, format="PNG")
            pages.image(stream, x, y, *size)
            _seams(pages, column, row, columns, rows, (x, y), size)
    return bytes(pages.output())


def _seams(pages, column, row, columns, rows, corner, size) -> None:  # type: ignore[no-untyped-def]
    """Lines at which a page is cut (right, below) to be laid on the next page's line."""
    margin, (x, y), (wide, high) = 1e3 * _OVERLAP, corner, size
    pages.set_draw_color(120)
    pages.set_line_width(0.15)
    for inside, place in ((column + 1 < columns, x + wide - margin), (column > 0, x + margin)):
        if inside:
            for start, end in ((0, y - 1), (y + high + 1, y + high + 6)):
                pages.line(place, max(start, y - 6), place, end)
    for inside, place in ((row + 1 < rows, y + high - margin), (row > 0, y + margin)):
        if inside:
            for start, end in ((x - 6, x - 1), (x + wide + 1, x + wide + 6)):
                pages.line(start, place, end, place)


def find_mat(photograph: Photograph) -> tuple[str, Points, Pixels] | None:
    """Which mat a photograph shows, centres of markers that are seen, and their pixels; None if
    there are fewer than :data:`MIN_MARKERS`.

    White paper outshines ink, so that markers look smaller than they are: their corners move, the
    intersection of their diagonals does not.
    """
    parameters = cv2.aruco.DetectorParameters()
    for name, value in _DETECTION.items():
        setattr(parameters, name, value)
    detector = cv2.aruco.ArucoDetector(
        cv2.aruco.getPredefinedDictionary(_DICTIONARY), parameters)
    found, numbers, _ = detector.detectMarkers(
        (255 * cv2.cvtColor(photograph.light, cv2.COLOR_RGB2GRAY)).astype(np.uint8))
    if numbers is None:
        return None
    seen = dict(zip(numbers.ravel().tolist(), found, strict=True))
    for name, mat in MATS.items():
        present = [number for number in mat.numbers if number in seen]
        if len(present) >= MIN_MARKERS:
            centres = mat.centres[[number - mat.first for number in present]]
            pixels = np.stack([_crossing(seen[number].reshape(4, 2)) for number in present])
            return name, np.column_stack([centres, np.zeros(len(centres))]), pixels
    return None


def _crossing(corners: np.ndarray) -> np.ndarray:
    """Where (2,) the diagonals of a quadrangle (4, 2) meet."""
    start, across = corners[0].astype(float), corners[1].astype(float)
    sides = np.column_stack([corners[2] - corners[0], corners[1] - corners[3]])
    return start + sides[:, 0] * np.linalg.solve(sides.astype(float), across - start)[0]
