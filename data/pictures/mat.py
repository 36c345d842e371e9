"""A printed mat under the plate's stand: its picture, pages to print, and its markers in pictures.

A ring of fiducial markers (AprilTag 36h11) surrounds the ground, with circles for the stand's foot.
The ground has a code (:mod:`data.pictures.code`), and markers of other numbers, or it is plain:
white, grey or blue. Coordinates, m, are in the plane of the mat: x along its arrow, y to the left
of it, from the centre of the circles.
"""

import io
from dataclasses import dataclass
from functools import cache
from itertools import product
from typing import Any, NamedTuple

import cv2
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from common.errors import InputError
from common.types import Mask, Metres, Pixels, Points
from data.pictures.code import CELL, black_dots, cells
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
CODE = "code"
GROUNDS = {CODE: (255, 255, 255), "white": (255, 255, 255), "grey": (128, 128, 128),
           "blue": (70, 120, 190)}
"""Colours, sRGB, of the mat around its markers. Grey of 128 reflects 22 % of the light of paper,
about the geometric mean of white cloth (85 %) and black cloth (4 %). Blue is as dark, for grey
cloth."""
_CODED = 200  # added to the numbers of the markers of a mat with the code
_DOTS, _DOT_SHARE = 5, 4 / 9  # along a grey cell, and of its area
_BARE = 0.025  # m, radius about the middle that has no code
FINE = CELL / 5  # m, pixel in which the code is compared with pictures
_LINE, _TEXT = 205, 150  # grey of lines and letters on white; as visible on other grounds
_THIN, _THICK, _AROUND = 0.25e-3, 1e-3, 1e-3  # m, of lines, and of paper around them on the code
QUIET = 5e-3  # m, white, around the markers
_BLUR = 6.0  # pixels, 0.5 mm
_OVERLAP = 2e-3  # m, by which parts on several pages overlap
_PAGES = {
    "a2": (594, 420),
    "a3": (420, 297),
    "tabloid": (431.8, 279.4),
    "a4": (297, 210),
    "letter": (279.4, 215.9),
}
"""Papers, mm, wide and high."""


@dataclass(frozen=True)
class Mat:
    """A mat's layout: width and height, m, number of markers along them, and the first's number on
    a plain one."""

    name: str
    size: tuple[Metres, Metres]
    along: tuple[int, int]
    first: int

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width of its picture, in pixels."""
        return self.shape_in(PIXEL)

    def shape_in(self, pixel: Metres) -> tuple[int, int]:
        """The same in pixels of a size."""
        width, height = (round((side + 2 * QUIET) / pixel) for side in self.size)
        return height, width

    def numbers(self, *, coded: bool) -> range:
        """Numbers of the markers."""
        first, (wide, high) = self.first + _CODED * coded, self.along
        return range(first, first + 2 * wide + 2 * (high - 2))

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


MATS = {"a3": Mat("a3", (0.396, 0.262), (10, 7), 0),
        "a2": Mat("a2", (0.530, 0.396), (13, 10), 100)}
PARTS = {("a3", "a3"): (1, 1), ("a3", "tabloid"): (1, 1), ("a3", "a4"): (2, 1),
         ("a3", "letter"): (2, 1), ("a2", "a2"): (1, 1), ("a2", "a4"): (2, 2),
         ("a2", "letter"): (2, 2)}
"""Columns and rows of pages, by mat and paper."""
FOOT, _MARGIN = "foot", 10e-3
"""The middle of the mat with the code, to lie on a wide foot; m, of its paper."""


@cache
def mat_picture(name: str, ground: str = "white") -> np.ndarray:
    """The mat (H, W) uint8, grey, :data:`PIXEL` a pixel, its arrow to the right; ``ground``: of
    :data:`GROUNDS`."""
    return np.asarray(_drawn(name, ground).convert("L"))


def mat_colours(name: str, ground: str = "white") -> np.ndarray:
    """The same in colours (H, W, 3) uint8, sRGB."""
    return np.asarray(_drawn(name, ground).convert("RGB"))


def _drawn(name: str, ground: str, pixel: Metres = PIXEL) -> Image.Image:
    """The mat's picture, grey unless its ground has a colour: a third of the work."""
    mat, colour = MATS[name], np.array(GROUNDS[ground])
    height, width = mat.shape_in(pixel)
    grey, coded = len(set(GROUNDS[ground])) == 1, ground == CODE

    def ink(tones: np.ndarray) -> Any:
        return int(tones[0]) if grey else tuple(tones.tolist())

    page = (Image.fromarray(_code_picture((height, width), round(CELL / pixel))) if coded else
            Image.new("L" if grey else "RGB", (width, height), ink(colour)))
    faint, dark = (0, 0) if coded else (ink(np.rint(255 * encoded(
        decoded(np.array(tone / 255)) * decoded(colour / 255))).astype(int))
        for tone in (_LINE, _TEXT))
    _draw(page, mat, pixel, "white", faint, dark, around=coded)
    for number, centre in zip(mat.numbers(coded=coded), mat.centres, strict=True):
        side = round(MARKER / pixel)
        marker = cv2.aruco.generateImageMarker(
            cv2.aruco.getPredefinedDictionary(_DICTIONARY), number, side)
        left, top = np.rint(np.array(mat_pixels(name, centre, pixel)) - side / 2).astype(int)
        page.paste(Image.fromarray(marker), (int(left), int(top)))
    return page


def _code_picture(shape: tuple[int, int], side: int) -> np.ndarray:
    """The code (H, W) uint8 in ``side`` pixels a cell: in black and white, unless they are few."""
    (rows, down), (columns, along) = (np.divmod(np.floor(np.arange(n) - (n - 1) / 2).astype(int),
                                                side) for n in shape)
    dots = black_dots(side, _DOTS) if side > 2 * _DOTS else _DOT_SHARE
    grey = np.rint(255 * (1 - dots * np.ones((side, side)))).astype(np.uint8)
    tones = np.stack([np.full_like(grey, 255), grey, np.zeros_like(grey)])
    middle = np.array(cells().shape) // 2
    code = cells()[rows[:, None] + middle[0], columns + middle[1]]
    return tones[code, down[:, None], along]


def _draw(page: Image.Image, mat: Mat, pixel: Metres, paper: Any, faint: Any, dark: Any, *,
          around: bool) -> None:
    """What a mat shows beside its ground and its markers, in pixels of a size; ``around``: with
    paper around lines and letters."""
    draw = ImageDraw.Draw(page)

    def at(x: Metres, y: Metres) -> tuple[float, float]:
        return page.width / 2 + x / pixel, page.height / 2 - y / pixel

    def disc(radius: Metres, wide: Metres = 0.0, **colours: Any) -> None:
        draw.ellipse([*at(-radius, radius), *at(radius, -radius)],
                     width=round(wide / pixel), **colours)

    def line(*points: tuple[Metres, Metres], wide: Metres = _THIN) -> None:
        for more, colour in ((_AROUND, paper), (0.0, faint))[not around :]:
            draw.line([at(*point) for point in points], fill=colour,
                      width=round((wide + more) / pixel))

    def write(x: Metres, y: Metres, text: str, size: Metres = 3.2e-3) -> None:
        font = ImageFont.load_default(size / pixel)
        if around:
            left, top, right, bottom = draw.textbbox(at(x, y), text, font, "mm")
            more = _AROUND / pixel
            draw.rectangle([left - more, top - more, right + more, bottom + more], fill=paper)
        draw.text(at(x, y), text, fill=dark, anchor="mm", font=font)

    half = MARKER / 2 + QUIET
    for x, y in mat.centres:
        draw.rectangle([*at(x - half, y + half), *at(x + half, y - half)], fill=paper)
    if around:
        disc(_BARE, fill=paper)
    for radius in _CIRCLES:
        if around:
            disc(radius + _AROUND / 2, _AROUND + _THIN, outline=paper)
        disc(radius, _THIN, outline=faint)
    for radius in _CIRCLES:
        write(0.71 * radius + 5e-3, -0.71 * radius - 2e-3, f"{2e3 * radius:g}", 2.5e-3)
    line((-0.1, 0), (0.1, 0))
    line((0, -0.1), (0, 0.1))
    inner_x, inner_y = (side / 2 - MARKER for side in mat.size)
    tip = inner_x - 4e-3
    line((0.11, 0), (tip, 0), wide=_THICK)
    line((tip - 8e-3, 5e-3), (tip, 0), (tip - 8e-3, -5e-3), wide=_THICK)
    write(tip - 8e-3, 9e-3, "WARP")
    write(0, inner_y - 5e-3, f"mat {mat.name}: print at 100 %, lay flat on a plain table; centre "
          "the foot on the circles, warp along the arrow")
    low = -inner_y + 4e-3
    line((-BAR / 2, low), (BAR / 2, low))
    for tick in np.linspace(-BAR / 2, BAR / 2, 21):
        line((tick, low), (tick, low + 3e-3))
    write(BAR / 2 + 32e-3, low + 1e-3, f"{1e3 * BAR:g} mm: measure it, state mat_bar_mm")


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
def code_page(name: str) -> tuple[np.ndarray, Mask]:
    """How grey, and how black, (2, H, W) float32 a mat with the code is, in pixels of :data:`FINE`;
    and where (H, W) it shows neither lines nor letters."""
    page = np.asarray(_drawn(name, CODE, FINE))
    plain = Image.new("L", page.shape[::-1], 255)
    _draw(plain, MATS[name], FINE, 255, 0, 0, around=True)
    black = page < 64
    return np.stack([~black & (page < 192), black]).astype(np.float32), np.asarray(plain) > 250


@cache
def _blurred(name: str, ground: str) -> tuple[np.ndarray, Metres]:
    """A mat's picture, a little blurred, and the size of its pixels: of the code, coarser ones, as
    the network that cuts cloth sees it."""
    pixel, blur = (FINE, 2.0) if ground == CODE else (PIXEL, _BLUR)
    return cv2.GaussianBlur(np.asarray(_drawn(name, ground, pixel).convert("L")), (0, 0),
                            blur), pixel


def printed_at(name: str, places: np.ndarray, ground: str = "white") -> tuple[np.ndarray, Mask]:
    """The print (H, W) uint8 at places (H, W, 2), m, 0 beside the mat, a little blurred, and where
    the mat is."""
    page, pixel = _blurred(name, ground)
    printed = cv2.remap(page, *mat_pixels(name, places, pixel), cv2.INTER_LINEAR, borderValue=0)
    half = np.array(MATS[name].size) / 2 + QUIET
    return printed, (np.abs(places) < half).all(axis=2)


def mat_pixels(name: str, places: np.ndarray, pixel: Metres = PIXEL
               ) -> tuple[np.ndarray, np.ndarray]:
    """Columns and rows (...,) float32, in pixels of :func:`mat_picture` or of another size, of
    places (..., 2), m."""
    height, width = MATS[name].shape_in(pixel)
    return ((places[..., 0] / pixel + (width - 1) / 2).astype(np.float32),
            (-places[..., 1] / pixel + (height - 1) / 2).astype(np.float32))


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


def mat_pages(name: str, paper: str, ground: str = CODE) -> bytes:
    """PDF of a mat, in as many pages as it needs on a paper, or of its middle alone,
    :data:`FOOT`; to be printed at 100 %."""
    from fpdf import FPDF

    sheet = sorted(_PAGES.get(paper, (0, 0)))
    if (name, paper) not in PARTS and (name != FOOT or paper not in _PAGES):
        choices = ", ".join(f"mat={one} paper={other}" for one, other in (
            *PARTS, *((FOOT, paper) for paper in _PAGES)))
        raise InputError(f"mat={name} paper={paper} does not fit; choose {choices}")
    if ground not in GROUNDS:
        raise InputError(f"ground={ground} is no colour of a mat; choose {', '.join(GROUNDS)}")
    columns, rows = PARTS.get((name, paper), (1, 1))
    picture = mat_colours("a2" if name == FOOT else name, ground)
    if name == FOOT:
        half = int((1e-3 * sheet[0] / 2 - _MARGIN) / PIXEL)
        row, column = (side // 2 for side in picture.shape[:2])
        picture = picture[max(row - half, 0) : row + half, column - half : column + half]
    extra = round(_OVERLAP / PIXEL)
    wide, high = picture.shape[1] // columns, picture.shape[0] // rows
    if wide >= high:
        sheet = sheet[::-1]
    pages = FPDF(unit="mm", format=(sheet[0], sheet[1]))
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


class SeenMat(NamedTuple):
    """Which mat a photograph shows, whether with the code, centres (M, 3) of the markers that are
    seen, and their pixels (M, 2)."""

    name: str
    coded: bool
    centres: Points
    pixels: Pixels


def find_mat(photograph: Photograph) -> SeenMat | None:
    """The mat of a photograph; None if fewer than :data:`MIN_MARKERS` are seen.

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
    for mat, coded in product(MATS.values(), (True, False)):
        numbers = mat.numbers(coded=coded)
        present = [number for number in numbers if number in seen]
        if len(present) >= MIN_MARKERS:
            centres = mat.centres[[number - numbers[0] for number in present]]
            pixels = np.stack([_crossing(seen[number].reshape(4, 2)) for number in present])
            return SeenMat(mat.name, coded, np.column_stack([centres, np.zeros(len(centres))]),
                           pixels)
    return None


def _crossing(corners: np.ndarray) -> np.ndarray:
    """Where (2,) the diagonals of a quadrangle (4, 2) meet."""
    start, across = corners[0].astype(float), corners[1].astype(float)
    sides = np.column_stack([corners[2] - corners[0], corners[1] - corners[3]])
    return start + sides[:, 0] * np.linalg.solve(sides.astype(float), across - start)[0]
