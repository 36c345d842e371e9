"""A photograph with a mat, as a camera straight above would see the plane of the plate."""

from dataclasses import dataclass

import cv2
import numpy as np

from common.errors import InputError
from common.findings import Finding
from common.types import Mask, Metres
from data.pictures.cut import Printed
from data.pictures.mat import find_mat, printed_at
from data.pictures.pose import Pose, camera_pose
from data.pictures.reading import Photograph

AROUND = 1.3  # of the flat specimen's reach, shown
SIDE = 1500  # pixels, at most
MAX_SCALE_ERROR = 0.006  # standard deviation, relative
_PRINT_EDGE = 60  # grey of the mat, over a pixel
_BLEED = 6e-4  # m, of print and its blur, and the error of its place


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


def straight_from_above(
    photograph: Photograph, others: list[Photograph], mat: str, *, plate_height: Metres,
    reach: Metres, ground: str = "white"
) -> OverMat:
    """Rectify a photograph of a drape over a ``mat``; InputError if it is not seen. ``others``:
    pictures of the mat by the same camera; ``reach``: radius of the flat specimen;
    ``ground``: of the mat."""
    seen = []
    for one in (photograph, *others):
        found = find_mat(one)
        if found is None or found[0] != mat:
            which = f"the mat {found[0]}" if found else "fewer than six markers"
            raise InputError(f"it shows {which}, not the mat {mat}; show the mat with its corners, "
                             "sharp and without glare, or correct outline.mat")
        seen.append(found[1:])
    height, width = photograph.light.shape[:2]
    if any(one.light.shape != photograph.light.shape for one in others):
        raise InputError("the pictures of the mat have different sizes; take all with one camera, "
                         "in one mode, all upright or all sideways")
    pose = camera_pose((width, height), seen, photograph.focal, photograph.no_focal)
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
    transparent = missing | (cv2.remap(photograph.transparent.astype(np.float32), columns, rows,
                                       cv2.INTER_LINEAR) > 0.5)

    def printed(places: np.ndarray) -> tuple[np.ndarray, Mask]:
        eye = pose.place[:2]
        return printed_at(mat, eye + (places - eye) * (pose.place[2] / above), ground)

    shown, on_mat = printed(np.dstack(np.meshgrid(steps, -steps)))
    shown = np.where(on_mat, shown, 0).astype(np.uint8)
    around = 2 * round(max(_BLEED, pixel) / pixel) + 1
    edges = cv2.morphologyEx(shown, cv2.MORPH_GRADIENT, np.ones((3, 3), np.uint8)) > _PRINT_EDGE
    edges = cv2.dilate(edges.astype(np.uint8), np.ones((around, around), np.uint8)) > 0
    error = float(pose.focal_error * plate_height / above)
    unsure = Finding("focal_length_unsure", {"value": error, "limit": MAX_SCALE_ERROR,
                                             "focal": float(pose.focal_error)})
    return OverMat(Photograph(light, transparent), pixel, pose, printed, edges,
                   (unsure,) * (error > MAX_SCALE_ERROR))
