"""A photograph from above as it was read, to be shown before an estimate, also if it is refused."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from common.documents import read_yaml
from common.errors import InputError
from common.types import ColourPicture, PixelPath, Radians
from data.captures.description import Description, OutlineSource
from data.captures.off_axis import AZIMUTHS
from data.captures.photograph import PhotographedOutline, read_outline
from data.captures.reader import DESCRIPTION, find_outline
from data.captures.scale import Scaled, scaled_photograph
from data.pictures.planes import mapped
from data.pictures.reading import read_photograph
from sim.rig import Rig

_GAP = 8  # points of a hem, a pixel apart, between parts that are shown as one


@dataclass(frozen=True)
class SeenPhotograph:
    """What is found in a photograph; coordinates are pixels of ``picture``.

    Attributes:
        picture: (H, W, 3), reduced, or seen from straight above if a mat is found.
        factor: how many pixels of a row of the file were averaged to each.
        plate: x, y and diameter of the plate; None if its size is not known.
        centred: whether its centre is known; otherwise it is drawn about the outline's centroid.
        hem: the outline; None if it is refused.
        outline: what is made of it; None if it is refused.
        specimen: border (N, 2) of the flat specimen, centred on the plate and turned by the warp;
            None if its size or its direction in the picture is not known.
        warp: ends (2, 2) of a line along the warp over the specimen; None if it is not stated.
        movable: whether another ``plate_px`` may be stated.
        refusal: why it cannot be estimated, or empty.
        unclear: parts (N, 2) of the outline that are not clearly seen.
        cameras: feet (C, 2) of the cameras of the pictures over a mat, in order.
        next_camera: foot (2,) of the camera of the picture that is asked for; None if none is.
    """

    picture: ColourPicture
    factor: int
    plate: tuple[float, float, float] | None
    centred: bool
    hem: PixelPath | None
    outline: PhotographedOutline | None
    movable: bool
    refusal: str = ""
    specimen: PixelPath | None = None
    warp: PixelPath | None = None
    unclear: tuple[PixelPath, ...] = ()
    cameras: PixelPath | None = None
    next_camera: np.ndarray | None = None


def seen_photograph(folder: Path) -> SeenPhotograph:
    """Read the photograph of a capture folder; InputError if it is no photograph from above."""
    file = folder / DESCRIPTION
    description = Description.of(read_yaml(file), file)
    photograph, rig = find_outline(folder), description.tester
    if photograph is None or rig is None:
        raise InputError("a photograph from above and its tester are missing", source=folder)
    source = description.outline or OutlineSource()
    movable = source.mat is None
    warp = description.warp_direction
    if warp is None and description.marked:
        warp = 0.0
    try:
        outline = read_outline(photograph, source, rig, warp)
    except InputError as error:
        return _refused(photograph, source, rig, warp, str(error))
    if outline.picture is None or outline.to_pixels is None:
        raise InputError(f"{photograph} is a text file, of which there is no picture")
    to_pixels, warp = outline.to_pixels, None if warp is None else warp + outline.turn
    cameras, next_camera = outline.cameras, outline.next_camera
    return SeenPhotograph(outline.picture, outline.factor, _plate(to_pixels, rig),
                          outline.centred, outline.hem, outline, movable,
                          specimen=_specimen(to_pixels, rig, warp),
                          warp=_along(to_pixels, rig, warp), unclear=_parts(outline),
                          cameras=mapped(np.array(cameras)[:, :2], to_pixels) if cameras else None,
                          next_camera=None if next_camera is None else mapped(
                              next_camera[None, :2], to_pixels)[0])


def _parts(outline: PhotographedOutline) -> tuple[PixelPath, ...]:
    """The parts of a hem, in pixels of its picture, that are not clearly seen."""
    assert outline.hem is not None and outline.to_pixels is not None
    x, y = mapped(outline.hem, np.linalg.inv(outline.to_pixels)).T
    angle = np.arctan2(y, x) - outline.turn
    azimuth = np.rint(angle * (AZIMUTHS / (2 * np.pi))).astype(int) % AZIMUTHS
    places = np.flatnonzero(outline.unclear[azimuth] if outline.unclear is not None else [])
    gaps = np.flatnonzero(np.diff(places) > _GAP) + 1
    return tuple(outline.hem[part] for part in np.split(places, gaps) if len(part) > 1)


def _refused(
    file: Path, source: OutlineSource, rig: Rig, warp: Radians | None, refusal: str
) -> SeenPhotograph:
    """What can be shown of a photograph whose outline is refused."""
    scaled: Scaled | None = None
    try:
        scaled = scaled_photograph(file, source, rig)
        photograph = scaled.photograph
    except InputError:
        photograph = read_photograph(file)
    plate = specimen = along = None
    if scaled is not None and scaled.middle is not None:
        to_pixels = np.linalg.inv(scaled.to_metres)
        plate, specimen, along = (_plate(to_pixels, rig), _specimen(to_pixels, rig, warp),
                                  _along(to_pixels, rig, warp))
    return SeenPhotograph(photograph.colour, photograph.factor, plate, plate is not None, None,
                          None, source.mat is None, refusal, specimen, along)


def _specimen(to_pixels: np.ndarray, rig: Rig, warp: Radians | None) -> PixelPath | None:
    """The flat specimen's border about the origin of a plane, in pixels of a picture; None of a
    rectangle whose ``warp`` is not stated."""
    if warp is None and rig.specimen != "disc":
        return None
    azimuth = np.linspace(0, 2 * np.pi, 361)  # a point at each corner of a square
    turned = azimuth + (warp or 0.0) + rig.cut
    around = np.column_stack([np.cos(turned), np.sin(turned)])
    return mapped(rig.border(azimuth)[:, None] * around, to_pixels)


def _along(to_pixels: np.ndarray, rig: Rig, warp: Radians | None) -> PixelPath | None:
    """Ends of a line along the ``warp``, as long as the specimen's reach on both sides."""
    if warp is None:
        return None
    end = rig.reach * np.array([[np.cos(warp), np.sin(warp)]])
    return mapped(np.vstack([-end, end]), to_pixels)


def _plate(to_pixels: np.ndarray, rig: Rig) -> tuple[float, float, float]:
    """Centre and diameter, pixels, of the plate about the origin of a plane in a picture."""
    radius = rig.plate_radius
    ends = mapped(radius * np.array([[1, 0], [-1, 0], [0, 1], [0, -1]]), to_pixels)
    x, y = mapped(np.zeros((1, 2)), to_pixels)[0]
    across = np.linalg.norm(ends[::2] - ends[1::2], axis=1)
    return float(x), float(y), float(across.mean())
