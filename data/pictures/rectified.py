"""A photograph with a mat, as a camera straight above would see the plane of the plate."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from common.errors import InputError
from common.findings import Finding
from common.types import Mask, Metres, Pixels, Points
from data.pictures.cut import Printed
from data.pictures.mat import SeenMat, find_mat
from data.pictures.planes import behind
from data.pictures.pose import CONTRADICTED, STATED_FOCAL, Pose, camera_poses
from data.pictures.reading import FULL_FRAME, Photograph

AROUND = 1.3  # of the flat specimen's reach, shown
SIDE = 1500  # pixels, at most
MAX_SCALE_ERROR = 0.006  # standard deviation, relative
FARTHEST = 2.0  # m above the plate, of cameras by hand, from ladders, and below most ceilings
_PRINT_EDGE = 60  # grey of the mat, over a pixel
_BLEED = 1.5e-3  # m, of print and its blur, and the error of its place


@dataclass(frozen=True)
class OverMat:
    """A photograph as seen straight from above, its middle the plate's centre, x along the mat's
    arrow to the right.

    Attributes:
        photograph: the picture.
        pixel: size of a pixel in the plane of the plate.
        printed: what the mat shows behind places of that plane.
        print_edges: (H, W) where edges may be those of the mat and of what is printed on it.
    """

    photograph: Photograph
    pixel: Metres
    pose: Pose
    printed: Printed
    print_edges: Mask
    warnings: tuple[Finding, ...] = ()


def markers_in(photograph: Photograph, mat: str) -> SeenMat:
    """The markers of a ``mat``; InputError if it is not seen."""
    found = find_mat(photograph)
    if found is None and find_mat(replace(photograph, light=np.ascontiguousarray(
            photograph.light[:, ::-1]))):
        raise InputError("it is mirrored; give it as the camera saw it, without mirroring")
    if found is None or found.name != mat:
        which = f"the mat {found.name}" if found else "fewer than six markers"
        raise InputError(f"it shows {which}, not the mat {mat}; show the mat with its corners, "
                         "sharp and without glare, or correct outline.mat")
    return found


def poses_of(
    photographs: Sequence[Photograph], seen: Sequence[tuple[Points, Pixels]], drapes: int
) -> list[Pose | InputError]:
    """Poses of pictures of which the first ``drapes`` show a drape and the rest the mat, by the
    first's camera, from :func:`markers_in` each; why there is none in its place. Pictures of one
    size and one stated focal length are by one camera, upright or sideways."""
    sizes = [one.light.shape[1::-1] for one in photographs]
    lenses = [(*sorted(size), None if one.focal is None else round(one.focal)) for size, one in zip(
        sizes, photographs, strict=True)]
    lenses[drapes:] = [lenses[0] if one[:2] == lenses[0][:2] else one for one in lenses[drapes:]]
    found: dict[int, Pose | InputError] = {}
    for lens in dict.fromkeys(lenses):
        mine = [k for k, other in enumerate(lenses) if other == lens]
        first = photographs[mine[0]]
        try:
            found |= zip(mine, camera_poses([sizes[k] for k in mine], [seen[k] for k in mine],
                                            first.focal, first.no_focal), strict=True)
        except InputError as error:
            found |= dict.fromkeys(mine, error)
    return [found[k] for k in range(drapes)]


def straight_from_above(
    photograph: Photograph, pose: Pose, mat: str, *, plate_height: Metres, reach: Metres,
    ground: str = "white"
) -> OverMat:
    """Rectify a photograph of a drape over a ``mat`` with a ``ground``; ``reach``: radius of the
    flat specimen. InputError for an impossible height."""
    height, width = photograph.light.shape[:2]
    above = pose.place[2] - plate_height
    if above < 0.15:
        raise InputError(f"the camera was {1e3 * pose.place[2]:.0f} mm over the mat, the plate is "
                         f"at {1e3 * plate_height:.0f}; check plate_height_mm, and hold the camera "
                         "at least 0.4 m above the plate")
    pixel = max(above / pose.focal, 2 * AROUND * reach / SIDE)
    count = int(2 * AROUND * reach / pixel)
    steps = (np.arange(count) - (count - 1) / 2) * pixel
    columns, rows = pose.pixels_of_plane(plate_height, steps)
    missing = (columns < 0) | (rows < 0) | (columns > width - 1) | (rows > height - 1)
    light = cv2.remap(photograph.light, columns, rows, cv2.INTER_LINEAR,
                      borderMode=cv2.BORDER_REPLICATE)
    transparent = cv2.remap(photograph.transparent.astype(np.float32), columns, rows,
                            cv2.INTER_LINEAR) > 0.5

    axes = np.array([[0, 0], [1, 0], [0, 1.0]])
    middle, *ends = behind(axes, pose.place, plate_height)
    to_mat = np.vstack([np.column_stack([*(end - middle for end in ends), middle]), [0, 0, 1]])
    printed = Printed(mat, ground, to_mat)
    shown, on_mat = printed.at(np.dstack(np.meshgrid(steps, -steps)))
    shown = np.where(on_mat, shown, 0).astype(np.uint8)
    around = 2 * round(max(_BLEED, pixel) / pixel) + 1
    edges = cv2.morphologyEx(shown, cv2.MORPH_GRADIENT, np.ones((3, 3), np.uint8)) > _PRINT_EDGE
    edges = cv2.dilate(edges.astype(np.uint8), np.ones((around, around), np.uint8)) > 0
    return OverMat(Photograph(light, transparent, missing=missing), pixel, pose, printed, edges,
                   tuple(_doubts(photograph, pose, plate_height)))


def _doubts(photograph: Photograph, pose: Pose, plate_height: Metres) -> Iterator[Finding]:
    """Warnings of a focal length that is not that of the file, puts the camera out of reach, or is
    not well known."""
    above = float(pose.place[2] - plate_height)
    unit = FULL_FRAME / float(np.hypot(*pose.size))
    if focal := photograph.focal:
        limit = CONTRADICTED * STATED_FOCAL
        if abs(np.log(pose.focal / focal)) > limit:
            yield Finding("focal_length_contradicts", {
                "value": unit * pose.focal, "stated": unit * focal, "limit": limit})
        elif above > FARTHEST:
            yield Finding("camera_far", {"value": 1e3 * above, "limit": 1e3 * FARTHEST,
                                         "focal": unit * focal})
    if (error := float(pose.focal_error * plate_height / above)) > MAX_SCALE_ERROR:
        yield Finding("focal_length_unsure", {"value": error, "limit": MAX_SCALE_ERROR,
                                              "focal": float(pose.focal_error)})
