"""A photograph from above as it was read, to be shown before an estimate, also if it is refused."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from common.documents import read_yaml
from common.errors import InputError
from common.types import ColourPicture, PixelPath
from data.captures.description import Description, OutlineSource
from data.captures.photograph import PhotographedOutline, read_outline
from data.captures.reader import DESCRIPTION, find_outline
from data.captures.scale import Scaled, scaled_photograph
from data.pictures.planes import mapped
from data.pictures.reading import read_photograph
from sim.rig import Rig


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
        movable: whether another ``plate_px`` may be stated.
        refusal: why it cannot be estimated, or empty.
    """

    picture: ColourPicture
    factor: int
    plate: tuple[float, float, float] | None
    centred: bool
    hem: PixelPath | None
    outline: PhotographedOutline | None
    movable: bool
    refusal: str = ""


def seen_photograph(folder: Path) -> SeenPhotograph:
    """Read the photograph of a capture folder; InputError if it is no photograph from above."""
    file = folder / DESCRIPTION
    description = Description.of(read_yaml(file), file)
    photograph, rig = find_outline(folder), description.tester
    if photograph is None or rig is None:
        raise InputError(f"{folder}: a photograph from above and its tester are missing")
    source = description.outline or OutlineSource()
    movable = source.mat is None
    try:
        outline = read_outline(photograph, source, rig)
    except InputError as error:
        return _refused(photograph, source, rig, str(error), movable=movable)
    if outline.picture is None or outline.to_pixels is None:
        raise InputError(f"{photograph} is a text file, of which there is no picture")
    return SeenPhotograph(outline.picture, outline.factor, _plate(outline.to_pixels, rig),
                          outline.centred, outline.hem, outline, movable)


def _refused(
    file: Path, source: OutlineSource, rig: Rig, refusal: str, *, movable: bool
) -> SeenPhotograph:
    """What can be shown of a photograph whose outline is refused."""
    scaled: Scaled | None = None
    try:
        scaled = scaled_photograph(file, source, rig)
        photograph = scaled.photograph
    except InputError:
        photograph = read_photograph(file)
    plate = None
    if scaled is not None and scaled.middle is not None:
        plate = _plate(np.linalg.inv(scaled.to_metres), rig)
    return SeenPhotograph(photograph.colour, photograph.factor, plate, plate is not None, None,
                          None, movable, refusal)


def _plate(to_pixels: np.ndarray, rig: Rig) -> tuple[float, float, float]:
    """Centre and diameter, pixels, of the plate about the origin of a plane in a picture."""
    radius = rig.plate_radius
    ends = mapped(radius * np.array([[1, 0], [-1, 0], [0, 1], [0, -1]]), to_pixels)
    x, y = mapped(np.zeros((1, 2)), to_pixels)[0]
    across = np.linalg.norm(ends[::2] - ends[1::2], axis=1)
    return float(x), float(y), float(across.mean())
