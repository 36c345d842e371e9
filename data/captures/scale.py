"""How a photograph's pixels lie in the plane of the plate.

By a mat under the stand, by the plate's place and size, in numbers or in a picture of the plate
without cloth, by the size of a pixel, or by a board in the plane of the plate.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from common.errors import InputError
from common.findings import Finding
from common.types import GreyPicture, Mask, Metres
from data.captures.board import MAX_REPROJECTION_ERROR, PAPER, SQUARE, SQUARES, find_corners
from data.captures.description import OutlineSource
from data.pictures.cut import Printed
from data.pictures.edge import edge_of, smoothed
from data.pictures.mat import BAR, CODE
from data.pictures.planes import mapped, shifted
from data.pictures.reading import SUFFIXES, Photograph, read_photograph
from data.pictures.rectified import markers_in, poses_of, straight_from_above
from sim.rig import Rig

_SIDE = 600  # pixels, of the picture in which circles are looked for (Hough)
_RADII = 0.05, 0.5  # of the picture's smaller side
MAX_OUT_OF_ROUND = 0.02  # of the radius, root mean square
_ROUND, _EDGE = 0.7, 60  # least share of a circle's edge, and its strength (OpenCV)
_NEAR = 3.0  # pixels, error of a circle
MAT_SIDE = 4500  # pixels, to which larger photographs with a mat are reduced
MAX_HEIGHT_DIFFERENCE = 0.15  # between a camera's height as stated and by its focal length
MAX_SCALE_DIFFERENCE = 0.03  # between the plate's diameter as seen and as a stated scale has it


def bare_plate(photograph: Photograph) -> tuple[np.ndarray, float]:
    """Centre (2,) and radius of the largest disc, in pixels of the picture; InputError if it shows
    none that differs from the ground."""
    size = photograph.light.shape[1::-1]
    scale = min(1.0, _SIDE / max(size))
    small = cv2.resize(photograph.grey.astype(np.uint8), None, fx=scale, fy=scale,
                       interpolation=cv2.INTER_AREA)
    least, most = (round(share * scale * min(size)) for share in _RADII)
    circles = cv2.HoughCircles(cv2.GaussianBlur(small, (0, 0), 1.5), cv2.HOUGH_GRADIENT_ALT, 1.5,
                               least, param1=_EDGE, param2=_ROUND, minRadius=least, maxRadius=most)
    smooth, best, out = smoothed(photograph.light), None, np.inf
    for x, y, radius in [] if circles is None else circles[0]:
        count = int(2 * np.pi * radius / scale)
        turn = np.arange(count) * (2 * np.pi / count)
        border = (np.array([x, y]) + 0.5) / scale - 0.5 + radius / scale * np.column_stack(
            [np.cos(turn), np.sin(turn)])
        line, _ = edge_of(smooth, border, np.full(count, _NEAR / scale), scale=_NEAR / scale)
        centre, radius = _circle(line)
        off = float(np.sqrt(np.mean((np.hypot(*(line - centre).T) / radius - 1) ** 2)))
        out = min(out, off)
        if off < MAX_OUT_OF_ROUND and radius > (best[1] if best else 0.0):
            best = centre, radius
    if best is None:
        seen = f"the roundest thing is {out:.0%} out of round" if out < 1 else "none is seen"
        raise InputError(f"no plate was found ({seen}, at most {MAX_OUT_OF_ROUND:.0%} is a plate): "
                         "show the whole plate from straight above, on a ground of another colour, "
                         "or state plate_px")
    return best


def _circle(line: np.ndarray) -> tuple[np.ndarray, float]:
    """Centre (2,) and radius of the circle nearest to points (N, 2) (least squares)."""
    design = np.column_stack([2 * line, np.ones(len(line))])
    x, y, rest = np.linalg.lstsq(design, (line**2).sum(axis=1), rcond=None)[0]
    return np.array([x, y]), float(np.sqrt(rest + x * x + y * y))


@dataclass(frozen=True)
class Scaled:
    """A photograph, and where it shows the plane of the plate.

    Attributes:
        to_metres: (3, 3) homography from pixels to that plane, about the plate's centre if
            ``middle`` is known: its place (2,), pixels.
        height: of the camera above the plate; NaN if it is not known.
        beside: place (2,) of the camera beside the axis, m; None if it is not known.
        printed: what a mat shows behind that plane.
        unsure: (H, W) where edges may not be those of cloth.
    """

    photograph: Photograph
    to_metres: np.ndarray
    height: Metres
    middle: np.ndarray | None = None
    beside: np.ndarray | None = None
    printed: Printed | None = None
    unsure: Mask | None = None
    warnings: tuple[Finding, ...] = ()

    @property
    def coded(self) -> Printed | None:
        """What a mat with the code shows; None of others."""
        return self.printed if self.printed and self.printed.ground == CODE else None

    @property
    def pixel(self) -> Metres:
        """Size of a pixel in the middle of the picture."""
        height, width = self.photograph.light.shape[:2]
        here = np.array([[width, height], [width + 2, height]]) / 2
        return float(np.linalg.norm(np.diff(mapped(here, self.to_metres), axis=0)))


def scaled_photograph(file: Path, source: OutlineSource, rig: Rig) -> Scaled:
    """Read a photograph, and its scale from what ``source`` states, from the picture, or from those
    beside it: ``plate.*``, ``mat_*``, and other pictures of the drape."""
    if isinstance(found := scaled_photographs(file, source, rig)[file], InputError):
        raise found
    return found


def scaled_photographs(
    file: Path, source: OutlineSource, rig: Rig
) -> dict[Path, Scaled | InputError]:
    """The same of all pictures of a drape, ``file`` and, over a mat, those called ``outline_2`` and
    so on beside it; what cannot be read of one, in its place."""
    others = [one for one in _beside(file, "outline_[1-6]") if one != file]
    if source.mat:
        return _by_mat([file, *others], source, rig)
    if others:
        raise InputError(f"{others[0].name} is beside it; several pictures of one drape need the "
                         "printed mat (outline: {mat: a3, plate_height_mm: 150})")
    found = _alone(file, source, rig)
    return {file: replace(found, warnings=(*found.warnings, *_height_contradicted(found)))}


def _height_contradicted(found: Scaled) -> list[Finding]:
    """A warning if the scale and the focal length of the file put the camera at another height than
    the stated one; a file that does not state it, parallel light, or no height have none."""
    seen = (found.photograph.focal or np.nan) * found.pixel
    if not np.isfinite(found.height) or not abs(np.log(seen / found.height)) > np.log1p(
            MAX_HEIGHT_DIFFERENCE):
        return []
    return [Finding("height_contradicts", {
        "value": 1e3 * seen, "stated": 1e3 * found.height, "limit": MAX_HEIGHT_DIFFERENCE,
        "causes": Finding("check_picture").text})]


def _alone(file: Path, source: OutlineSource, rig: Rig) -> Scaled:
    """The scale without a mat."""
    photograph = read_photograph(file)
    if beside := _beside(file, "plate"):
        return _by_plate(photograph, beside[0], source, rig)
    if plate := source.plate_px:
        centre = (np.array([plate.x, plate.y]) + 0.5) / photograph.factor - 0.5
        pixel = rig.plate_diameter * photograph.factor / plate.diameter
        return Scaled(photograph, _about(centre, pixel), source.height, centre)
    if source.mm_per_px:
        pixel = 1e-3 * source.mm_per_px * photograph.factor
        stated = 1e3 * (photograph.spacing or np.nan)
        other = abs(stated / source.mm_per_px - 1) > MAX_SCALE_DIFFERENCE
        return Scaled(photograph, np.diag([pixel, -pixel, 1.0]), source.height, warnings=(Finding(
            "scale_contradicts", {"value": stated, "stated": source.mm_per_px}),) * other)
    if plane := board_plane(photograph.grey):
        return Scaled(photograph, plane[0], source.height, unsure=plane[1])
    raise InputError("the scale is not known: lay the printed mat under the stand (outline: {mat: "
                     "a3, plate_height_mm: 150}), add plate.jpg, the same picture without cloth, "
                     "or give outline: {plate_px: {x: 960, y: 540, diameter: 700}} or mm_per_px")


def _by_mat(
    files: list[Path], source: OutlineSource, rig: Rig
) -> dict[Path, Scaled | InputError]:
    """The scale of pictures of a drape by one camera over a mat."""
    assert source.mat and source.plate_height_mm
    found: dict[Path, Scaled | InputError] = {}
    photographs, seen = [], []
    mats = _beside(files[0], "mat_*")
    for file in [*files, *mats]:
        try:
            photograph = read_photograph(file, side=MAT_SIDE)
            seen.append(markers_in(photograph, source.mat))
            photographs.append(photograph)
        except InputError as error:
            if file in mats or len(files) == 1:
                raise
            found[file] = error
    files = [file for file in files if file not in found]
    if not files:
        return found
    scale, plate_height = mat_scale(source), 1e-3 * source.plate_height_mm
    poses = poses_of(photographs, [one[2:] for one in seen], len(files))
    for file, mat, pose in zip(files, seen, poses, strict=False):
        photograph = photographs.pop(0)  # large
        try:
            if isinstance(pose, InputError):
                raise pose
            over = straight_from_above(
                photograph, pose, source.mat, plate_height=plate_height / scale,
                reach=rig.reach / scale,
                ground=CODE if mat.coded else source.ground)
        except InputError as error:
            found[file] = error
            continue
        height, width = over.photograph.light.shape[:2]
        middle = np.array([width - 1, height - 1]) / 2
        place = scale * pose.place
        found[file] = Scaled(over.photograph, _about(middle, scale * over.pixel), float(place[2]) -
                             plate_height, middle, place[:2], replace(
                                 over.printed, to_mat=over.printed.to_mat @ np.diag(
                                     [1 / scale, 1 / scale, 1])),
                             over.print_edges, over.warnings)
    return found


def mat_scale(source: OutlineSource) -> float:
    """Lengths on the printed mat over those of its layout."""
    return 1e-3 * source.mat_bar_mm / BAR if source.mat_bar_mm else 1.0


def _by_plate(photograph: Photograph, file: Path, source: OutlineSource, rig: Rig) -> Scaled:
    """The scale by a picture of the plate without cloth."""
    empty = read_photograph(file)
    if empty.light.shape != photograph.light.shape:
        raise InputError(f"{file.name} has another size; take both pictures with one camera that "
                         "does not move")
    try:
        centre, radius = bare_plate(empty)
    except InputError as error:
        raise InputError(f"{file.name}: {error}") from None
    pixel = rig.plate_radius / radius
    for name, stated in (
            ("plate_px.diameter", source.plate_px and
             rig.plate_diameter * photograph.factor / source.plate_px.diameter),
            ("mm_per_px", source.mm_per_px and 1e-3 * source.mm_per_px * photograph.factor)):
        if stated and abs(pixel / stated - 1) > MAX_SCALE_DIFFERENCE:
            raise InputError(
                f"{file.name} shows a plate of {2 * radius * photograph.factor:.0f} pixels, by "
                f"{name} one of {1e3 * rig.plate_diameter:g} mm has "
                f"{rig.plate_diameter * photograph.factor / stated:.0f}; leave {name} out, or "
                "correct the tester")
    return Scaled(photograph, _about(centre, pixel), source.height, centre)


def _beside(file: Path, name: str) -> list[Path]:
    """Pictures of a name beside a file, in order."""
    return sorted(one for one in file.parent.glob(f"{name}.*") if one.suffix.lower() in SUFFIXES)


def _about(centre: np.ndarray, pixel: Metres) -> np.ndarray:
    """Homography from pixels to m about a centre (2,), y up."""
    return np.diag([pixel, -pixel, 1.0]) @ shifted(-centre)


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
