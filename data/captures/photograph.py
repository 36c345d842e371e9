"""Outlines of drapes from above, cut out of a photograph or read from a text file, and checked.

    picture -> scale (mat, plate, pixel or board) -> cut-out -> over the code, where that is seen
    -> curve in the plane of the plate
    curves of several pictures over a mat -> one (:mod:`data.captures.joined_outlines`)

Coordinates of pixels are those of their centres, from 0 on.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from hashlib import sha256
from pathlib import Path

import cv2
import numpy as np

from common.documents import read_bytes
from common.errors import InputError, of
from common.findings import Finding
from common.types import Metres, Outline, PixelPath, Radians, Vector
from data.captures.clarity import Clarity, jagged_hem, side, sides
from data.captures.description import MAX_COEFFICIENT, OUTLINE_TABLES, OutlineSource
from data.captures.ground import Ground
from data.captures.hem import unlike_cloth
from data.captures.joined_outlines import (
    MAX_PARTED,
    MAX_UNLIKE,
    SeenOutline,
    around,
    join_outlines,
    on_axis,
    turned,
)
from data.captures.off_axis import AZIMUTH, AZIMUTHS, OUTWARDS
from data.captures.outline_table import read_closed_curve
from data.captures.plate_height import MAX_OFF, height_off
from data.captures.scale import Scaled, scaled_photographs
from data.pictures.cut import SHEER, Cut, outline_of_cloth
from data.pictures.planes import mapped, shifted, upright
from data.pictures.reading import MAX_FILE_BYTES
from data.pictures.uncovered import uncover
from data.readings.known import MIN_COEFFICIENT
from sim.outlines import closed, coefficient_of_area, farthest, folds_around
from sim.rig import Rig

MAX_PIXEL = 1.5e-3  # m
MAX_TILT = np.radians(10.0)
MAX_GROUNDED, MAX_GLARE = 0.02, 0.05  # of the azimuth
HANGING = 0.005  # m, allowed to reach below the mat, of specimens that are not centred
MAX_REACH = 1.03  # over the flat specimen's; one of 1000 simulated outlines has more
MIN_RADIUS = {True: 0.97, False: 0.9}  # over the plate's, by whether its centre is known
USUAL_RADIUS = 0.99  # the same, where it is known: sound ones have 1.01 or more
MAX_OVERLAP, MAX_DISORDER = 0.03, 0.5  # of azimuth
MAX_GAP = np.radians(15.0)
MAX_SPARSE = np.radians(5.0)  # between points of a table whose shape is judged
MAX_SKEW = np.sin(np.radians(2.0))  # a mirrored warp is then at most 2° off, as it is stated


@dataclass(frozen=True)
class PhotographedOutline:
    """The outline of a drape from above, as it looks in the plane of the plate.

    Attributes:
        curve: counter-clockwise about the plate's centre if ``centred``, else about its centroid; x
            to the right in the picture, y up.
        height: of the camera above the plate; infinite for parallel light, NaN if unknown.
        picture: (H, W, 3) uint8, reduced; None if the outline is read from a text file.
        to_pixels: (3, 3) homography from the plane of ``curve`` to pixels of ``picture``, but for
            the ``turn``.
        turn: counter-clockwise from ``curve``, rad, of the plate with the drape in ``picture``.
        pixel: size of a pixel of the file at the plate.
        factor: how many pixels of a row of the file were averaged to each of ``picture``.
        hem: the outline as it was seen, in pixels of ``picture``.
        error: (720,) m, standard deviation of ``radii``; None if it is not known.
        clarity: of the hem in one picture; None if there is no picture.
        unclear: (720,) where the hem is not clearly seen; None if there is no picture.
        cameras: places (3,), m from the plate's centre, of the pictures over a mat, in order.
        next_camera: place (3,) from which another picture is asked for; None if none is.
        check: code of what to check where the outline contradicts what is stated.
        files_sha256: of the bytes of its files, the same whatever is stated with them.
    """

    curve: Outline
    height: Metres
    centred: bool
    rig: Rig
    warnings: tuple[Finding, ...] = ()
    picture: np.ndarray | None = None
    to_pixels: np.ndarray | None = None
    pixel: Metres = np.nan
    hem: PixelPath | None = None
    factor: int = 1
    error: np.ndarray | None = None
    clarity: Clarity | None = None
    unclear: np.ndarray | None = None
    cameras: tuple[Vector, ...] = ()
    next_camera: Vector | None = None
    check: str = "check_table"
    files_sha256: tuple[str, ...] = ()
    turn: Radians = 0.0

    @property
    def causes(self) -> str:
        """What to check where the outline contradicts what is stated, the likeliest first."""
        return Finding(self.check).text

    @property
    def radii(self) -> np.ndarray:
        """Outermost distances (720,), m, from the origin at equally spaced azimuths from x on."""
        return farthest(closed(self.curve), AZIMUTHS)

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
        return (points if self.to_pixels is None else
                mapped(turned(points, self.turn), self.to_pixels))


def read_outline(
    file: Path, source: OutlineSource, rig: Rig, warp_direction: Radians | None = None
) -> PhotographedOutline:
    """Read an outline from a photograph or a text file; InputError if it is not of a drape.

    ``warp_direction`` of the cloth, None if it is not marked, is that of its mirror image, too, if
    it lies along x or y.
    """
    is_table = file.suffix.lower() in OUTLINE_TABLES
    others = source.OF_PHOTOGRAPHS if is_table else source.OF_TABLES
    if wrong := sorted(source.model_fields_set.intersection(others)):
        kind = "a photograph" if is_table else "a text file"
        raise InputError(f"outline.{wrong[0]} is of {kind}, but the outline is {file.name}; "
                         "leave it out")
    with of(file):
        if is_table:
            handed = warp_direction is not None and abs(np.sin(2 * warp_direction)) > MAX_SKEW
            found = _tabulated(file, source, rig, handed=handed)
            digests = [_sha256(file)]  # of a file that is regular, as it was read
        else:
            pictures = dict(sorted(scaled_photographs(file, source, rig).items()))
            digests = [_sha256(one) for one in pictures]
            found = _photographed(file, pictures, digests, source, rig, warp_direction)
        warnings = (*found.warnings, *_checked(found))
    if np.isnan(found.height):
        warnings += (Finding("camera_height_missing"),)
    if not found.centred:
        warnings += (Finding("centre_unknown_in_table" if is_table else
                             "centre_unknown_in_picture"),)
    return replace(found, warnings=warnings, files_sha256=tuple(digests))


def _sha256(file: Path) -> str:
    return sha256(read_bytes(file, MAX_FILE_BYTES, "photograph")).hexdigest()


def _tabulated(
    file: Path, source: OutlineSource, rig: Rig, *, handed: bool
) -> PhotographedOutline:
    curve = read_closed_curve(file, source, handed=handed)
    curve = curve[:-1] if np.array_equal(curve[0], curve[-1]) else curve
    return PhotographedOutline(_oriented(curve if source.centred else curve - _centroid(curve)),
                               source.height, source.centred, rig)


def _photographed(
    file: Path, pictures: Mapping[Path, Scaled | InputError], digests: Sequence[str],
    source: OutlineSource, rig: Rig, warp_direction: Radians | None
) -> PhotographedOutline:
    """The outline of a drape from the axis, from one picture or from all that are called as it is;
    ``digests``: of each of the ``pictures``."""
    read: dict[Path, tuple[Scaled, PhotographedOutline]] = {}
    unread: dict[Path, InputError] = {}
    first: dict[str, Path] = {}
    for (one, seen), digest in zip(pictures.items(), digests, strict=True):
        try:
            if isinstance(seen, InputError):
                raise seen
            if (other := first.setdefault(digest, one)) is not one:
                raise InputError(f"it is the same picture as {other.name}")
            read[one] = seen, _as_seen(seen, source, rig)
        except InputError as error:
            unread[one] = error
    if not read:
        raise unread[file]
    warnings = [Finding("picture_unread", {"picture": one.name, "reason": str(error)})
                for one, error in unread.items()]
    (seen, found), *others = read.values()
    if seen.beside is None:
        return _judged(found, found.clarity)
    first_side = (warp_direction or 0.0) + rig.cut
    if others:
        return _joined(read, first_side, warnings, source)
    found = _judged(found, found.clarity)
    radius, error = (values[0] for values in on_axis([_view(seen, found, first_side)], rig))
    return replace(found, curve=turned(radius[:, None] * OUTWARDS, first_side),
                   error=around(error, -first_side), warnings=(*found.warnings, *warnings))


def _view(seen: Scaled, found: PhotographedOutline, first_side: Radians) -> SeenOutline:
    """A picture over the mat, turned such that the first side of a rectangle is along x."""
    assert seen.beside is not None and found.error is not None
    return SeenOutline(found.curve, seen.beside, seen.height, found.error).turned(-first_side)


def _joined(
    read: dict[Path, tuple[Scaled, PhotographedOutline]], first_side: Radians,
    warnings: list[Finding], source: OutlineSource
) -> PhotographedOutline:
    """One outline of several pictures over the mat, shown in the one nearest to the axis."""
    names = list(read)
    views = [_view(seen, found, first_side) for seen, found in read.values()]
    rig = read[names[0]][1].rig
    ground = Ground.of(source)
    assert ground is not None  # several pictures are read over a mat alone
    together = join_outlines(views, rig, ground.plate_height)
    warnings += [Finding("picture_contradicts", {"picture": file.name, "limit": MAX_UNLIKE})
                 for k, file in enumerate(names) if k not in together.used]
    used = [names[k] for k in together.used]
    warnings += [Finding("picture_turned", {
        "picture": names[k].name, "first": names[0].name,
        "value": float(np.degrees(together.turned[k]))})
        for k in together.used if together.turned[k]]
    if together.parted:
        azimuth, share = together.parted
        warnings.append(Finding("pictures_differ", {
            "first": used[0].name,
            "second": used[1].name,
            "value": share,
            "limit": MAX_PARTED,
            "place": f"at the {side(azimuth + first_side)}"}))
    if (share := float(together.grounded.mean())) > MAX_GROUNDED:
        here = around(together.grounded.astype(float), -first_side) > 0.5
        warnings.append(Finding("hem_on_ground", {
            "value": share, "limit": MAX_GROUNDED, "place": sides(here)}))
    height = ground.plate_height
    if off := height_off([read[names[k]][0] for k in together.used], rig, height):
        warnings.append(Finding("plate_height_contradicts", {
            "value": 1e3 * (height + off), "stated": 1e3 * height, "limit": MAX_OFF,
            "causes": Finding("check_mat").text}))
    said = [warning for file in used for warning in read[file][1].warnings]
    often = Counter(warning.code for warning in said)  # the others make up for one picture's fault
    warnings += {warning.code: warning for warning in reversed(said)
                 if 2 * often[warning.code] >= len(used)}.values()
    turn = together.turned[together.reference]
    shown = replace(read[names[together.reference]][1], turn=turn)
    # Nothing is seen inside the plate; what was, stays for the checks.
    radius = np.maximum(together.radius, np.minimum(together.seen, rig.plate_radius))
    curve, hem = (turned(one[:, None] * OUTWARDS, first_side) for one in (radius, together.seen))
    outline = replace(shown, curve=curve, hem=shown.drawn(hem), warnings=tuple(warnings),
                      error=around(together.error, -first_side),
                      cameras=tuple(read[file][1].cameras[0] for file in used))
    return _judged(outline, Clarity.together([
        clarity.turned(-together.turned[k]) for k in together.used
        if (clarity := read[names[k]][1].clarity)]))


def _judged(outline: PhotographedOutline, clarity: Clarity | None) -> PhotographedOutline:
    """An outline with warnings of what is not clearly seen of it."""
    assert clarity is not None
    next_camera, warnings = clarity.judged(outline.radii, outline.cameras)
    return replace(outline, warnings=(*warnings, *outline.warnings), next_camera=next_camera,
                   unclear=clarity.unclear)


def _as_seen(seen: Scaled, source: OutlineSource, rig: Rig) -> PhotographedOutline:
    """The outline of the cloth in one picture, on the plane of the plate, from where it was taken;
    InputError if no cloth is found."""
    photograph, to_metres = seen.photograph, seen.to_metres
    cut, warnings = _cut(seen, rig)
    pixels = cut.hem
    tilt = 0.0
    if seen.middle is None:
        to_metres, tilt = upright(to_metres, _centroid(pixels))
        to_metres = shifted(-_centroid(mapped(pixels, to_metres))) @ to_metres
    curve = mapped(pixels, to_metres)
    to_pixels = np.linalg.inv(to_metres)
    millimetre = np.diff(mapped(np.array([[0, 0], [1e-3, 0]]), to_pixels), axis=0)
    pixel = float(1e-3 / np.linalg.norm(millimetre))
    error, curve = _by_azimuth(curve, pixel * cut.error), _oriented(curve)
    step = pixel / photograph.factor
    if step > MAX_PIXEL:
        warnings.append(Finding("pixel_large", {"value": 1e3 * step, "limit": 1e3 * MAX_PIXEL}))
    if tilt > MAX_TILT:
        warnings.append(Finding("plate_tilted", {"value": float(np.degrees(tilt)),
                                                 "limit": float(np.degrees(MAX_TILT))}))
    cameras: tuple[Vector, ...] = ()
    if seen.beside is not None:
        require_height(curve, rig, 1e-3 * (source.plate_height_mm or np.inf), seen.height)
        cameras = (np.append(seen.beside, seen.height),)
    found = PhotographedOutline(
        curve, seen.height, seen.middle is not None, rig, tuple(warnings), photograph.colour,
        to_pixels, step, pixels, photograph.factor, cameras=cameras,
        check="check_mat" if source.mat else "check_picture")
    unlike = unlike_cloth(found.radii, rig)
    return replace(found, error=np.maximum(error, unlike), clarity=Clarity.of(
        found.radii, error, unlike, cameras, Ground.of(source, coded=bool(seen.coded))))


def _cut(seen: Scaled, rig: Rig) -> tuple[Cut, list[Finding]]:
    """The cloth in one picture, and warnings."""
    to_pixels, warnings = np.linalg.inv(seen.to_metres), [*seen.warnings]
    cut = outline_of_cloth(
        seen.photograph, to_pixels, plate=rig.plate_radius, reach=rig.reach,
        known=seen.middle is not None, printed=seen.printed, unsure=seen.unsure)
    if seen.coded:
        cut, glare = uncover(
            cut, seen.photograph, to_pixels, seen.coded, plate=rig.plate_radius, reach=rig.reach,
            unlike=lambda radii: unlike_cloth(radii, rig))
        if (share := float(glare.mean())) > MAX_GLARE:
            warnings.append(Finding("mat_overexposed", {
                "value": share, "limit": MAX_GLARE, "place": sides(glare)}))
    return cut, warnings


def _by_azimuth(curve: Outline, error: np.ndarray) -> np.ndarray:
    """Errors (720,) at equally spaced azimuths of those of a curve's points (N,)."""
    angle = np.arctan2(curve[:, 1], curve[:, 0])
    order = np.argsort(angle)
    return np.interp(AZIMUTH, angle[order], error[order], period=2 * np.pi)


def require_height(curve: Outline, rig: Rig, plate_height: Metres, camera: Metres) -> None:
    """InputError if cloth with this outline, seen from a ``camera``'s height above the plate, hangs
    deeper than the mat, ``plate_height`` below the plate: what does not reach outwards hangs down,
    where it is nearest, and in the mean at least along the chord of its arc.

    Of 5627 simulated drapes one in 100 hangs less deep by 3 mm, none by 8."""
    lowest = plate_height + HANGING
    outwards = farthest(closed(curve), AZIMUTHS) * (1 + lowest / camera) - rig.plate_radius
    overhang = float(rig.border(AZIMUTH).mean()) - rig.plate_radius
    chord = overhang**2 - max(outwards.mean(), 0) ** 2
    if chord > lowest**2 or rig.least_overhang - outwards.min() > lowest:
        raise InputError(
            f"cloth with this outline hangs more than {1e3 * lowest:.0f} mm below the plate, and so"
            f" below the mat by plate_height_mm={1e3 * plate_height:g}; check "
            f"{Finding('check_mat').text}, and that no cloth lies on the mat")


def _checked(outline: PhotographedOutline) -> list[Finding]:
    """Warnings; InputError for a curve that cannot be of a drape on this plate, with its causes."""
    curve, rig, causes = outline.curve, outline.rig, f"check {outline.causes}"
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
                         f" {causes}")
    nearest, rim = outline.radii.min(), rig.plate_radius
    if nearest < MIN_RADIUS[outline.centred] * rim:
        raise InputError(f"the outline comes within {1e3 * nearest:.1f} mm of the plate's centre, "
                         f"inside the plate of {1e3 * rim:g} mm radius; {causes}")
    if not MIN_COEFFICIENT <= (coefficient := outline.drape_coefficient) <= MAX_COEFFICIENT:
        raise InputError(f"the drape coefficient is {coefficient:.1%}, only {MIN_COEFFICIENT:.0%} "
                         f"to 100% is possible; {causes}, and that the outline is not that of the "
                         "plate or of a hole" + SHEER * bool(outline.cameras))
    warnings = []
    if coefficient > 1:
        warnings.append(Finding("outline_too_large", {"value": coefficient,
                                                      "causes": outline.causes}))
    if (width := _least_width(curve)) > MAX_REACH * min(rig.sides):
        warnings.append(Finding("hem_wide", {
            "value": 1e3 * width, "limit": 1e3 * min(rig.sides), "causes": outline.causes}))
    if outline.centred and nearest < USUAL_RADIUS * rim:
        warnings.append(Finding("hem_inside_plate", {
            "value": 1e3 * float(nearest), "limit": 1e3 * rim, "causes": outline.causes,
            "place": f"at the {side(AZIMUTH[outline.radii.argmin()])}"}))
    if disorder > MAX_OVERLAP:
        warnings.append(Finding("outline_turns_back", {"value": float(disorder),
                                                       "limit": MAX_OVERLAP}))
    outwards = curve - _centroid(curve)
    x, y = outwards[np.linalg.norm(outwards, axis=1).argmax()]
    if np.hypot(x, y) > MAX_REACH * rig.reach:
        warnings.append(Finding("hem_beyond_specimen", {
            "value": 1e3 * float(np.hypot(x, y)), "limit": 1e3 * rig.reach,
            "causes": outline.causes, "place": f"at the {side(float(np.arctan2(y, x)))}"}))
    if outline.clarity is None and gap < MAX_SPARSE:
        warnings += jagged_hem(unlike_cloth(outline.radii, rig))
    return warnings


def _least_width(curve: Outline) -> Metres:
    """Width of a curve in the direction in which it is least wide."""
    angle = np.arange(180) * (np.pi / 180)
    return float(np.ptp(curve @ np.stack([np.cos(angle), np.sin(angle)]), axis=0).min())


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
