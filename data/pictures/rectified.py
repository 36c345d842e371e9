"""A photograph with a mat, as a camera straight above would see the plane of the plate."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from scipy.ndimage import distance_transform_edt

from common.errors import InputError
from common.findings import Finding
from common.types import Mask, Metres, Pixels, Points
from data.pictures.cloth import BEYOND
from data.pictures.mat import MARKER, MATS, PIXEL, QUIET, find_mat, mat_picture, mat_pixels
from data.pictures.pose import Pose, camera_poses
from data.pictures.reading import Photograph, decoded, encoded

AROUND = 1.3  # of the flat specimen's reach, shown
SIDE = 1500  # pixels, at most
MAX_SCALE_ERROR = 0.006  # standard deviation, relative
INK = 60  # grey of the mat, below which it is printed: markers; lines are light and thin
_BLEED = 6e-4  # m, of print and its blur
_INK_COLOUR, _INK_LIGHT = 0.12, 0.35  # of the paper's light
_MAX_INKY = 0.05  # of the cloth on the plate, that is like ink
_INPAINTED = 3  # pixels, radius
_PAPER_AROUND = 4e-3  # m, over which the paper around ink is averaged


@dataclass(frozen=True)
class OverMat:
    """A photograph as seen straight from above, its middle the plate's centre, x along the mat's
    arrow to the right.

    Attributes:
        photograph: the picture, without what is printed on the mat.
        pixel: size of a pixel in the plane of the plate.
        ground: (H, W) what surely shows mat or table.
        paper: (H, W) where the mat is, covered or not.
    """

    photograph: Photograph
    pixel: Metres
    ground: Mask
    paper: Mask
    pose: Pose
    warnings: tuple[Finding, ...] = ()


def markers_in(photograph: Photograph, mat: str) -> tuple[Points, Pixels]:
    """Centres of the markers of a ``mat`` and their pixels; InputError if it is not seen."""
    found = find_mat(photograph)
    if found is None or found[0] != mat:
        which = f"the mat {found[0]}" if found else "fewer than six markers"
        raise InputError(f"it shows {which}, not the mat {mat}; show the mat with its corners, "
                         "sharp and without glare, or correct outline.mat")
    return found[1:]


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
    photograph: Photograph, pose: Pose, markers: Points, mat: str, *, plate_height: Metres,
    plate: Metres, reach: Metres
) -> OverMat:
    """Rectify a photograph of a drape over a ``mat`` whose ``markers`` it shows; ``plate``,
    ``reach``: radii of the plate and of the flat specimen. InputError for an impossible height."""
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
    far = np.hypot(steps, steps[:, None])
    # What is printed, seen through the plane of the plate: a column has one x, a row one y.
    axes = [at + (along - at) * (pose.place[2] / above)
            for at, along in zip(pose.place[:2], (steps, -steps), strict=True)]
    on_mat = np.dstack(np.meshgrid(*axes))
    transparent = missing | (cv2.remap(photograph.transparent.astype(np.float32), columns, rows,
                                       cv2.INTER_LINEAR) > 0.5)
    # Of markers that are read, nothing is covered.
    in_column, in_row = (np.abs(along[:, None] - markers) < MARKER / 2 + QUIET
                         for along, markers in zip(axes, markers.T[:2], strict=True))
    read = in_row.astype(np.float32) @ in_column.T.astype(np.float32) > 0
    ground = ((far > BEYOND * reach) | read) & ~missing
    half = np.array(MATS[mat].size) / 2 + QUIET
    paper = (np.abs(axes[1]) < half[1])[:, None] & (np.abs(axes[0]) < half[0])
    white = np.quantile(light[ground & paper], 0.9, axis=0)
    share, painted = _without_print(light / np.maximum(white, 1e-3), mat, on_mat, pixel, read=read,
                                    on_plate=far < plate)
    cleared = Photograph(white * share, transparent, painted=painted)
    error = float(pose.focal_error * plate_height / above)
    unsure = Finding("focal_length_unsure", {"value": error, "limit": MAX_SCALE_ERROR,
                                             "focal": float(pose.focal_error)})
    return OverMat(cleared, pixel, ground, paper, pose, (unsure,) * (error > MAX_SCALE_ERROR))


def _without_print(
    light: np.ndarray, mat: str, on_mat: np.ndarray, pixel: Metres, *, read: Mask, on_plate: Mask
) -> tuple[np.ndarray, Mask | None]:
    """Light (H, W, 3), of that of white paper, without what is printed on a mat at places (H, W,
    2), m; and where it is guessed, None if nowhere.

    Ink of markers that are ``read`` is seen. Elsewhere cloth may lie above it: what is dark without
    colour is ink, unless the cloth on the plate is so, too.
    """
    bleed = max(_BLEED, 2 * pixel)
    wide = 2 * round(bleed / PIXEL) + 1
    picture = mat_picture(mat)
    printed, core = (cv2.remap(one, *mat_pixels(mat, on_mat), cv2.INTER_NEAREST,
                               borderValue=255) < INK
                     for one in (cv2.erode(picture, np.ones((wide, wide), np.uint8)),
                                 cv2.dilate(picture, np.ones((wide // 2 | 1,) * 2, np.uint8))))
    printed &= ~on_plate
    tinted = np.ptp(light, axis=2) > _INK_COLOUR
    dark = ~tinted & (light.mean(axis=2) < _INK_LIGHT)
    if dark[on_plate].mean() > _MAX_INKY:
        around = np.ones((2 * round(bleed / pixel) + 1,) * 2, np.uint8)
        seen = printed & (read | (cv2.dilate((dark & printed).astype(np.uint8), around) > 0))
        shown = np.rint(255 * encoded(np.clip(light, 0, 1))).astype(np.uint8)
        filled = decoded(cv2.inpaint(shown, seen.astype(np.uint8), _INPAINTED, cv2.INPAINT_TELEA)
                         / 255)
        return np.where(seen[..., None], filled, light).astype(np.float32), seen
    # Of what is printed around a core, as much is seen as of the core.
    rows, columns = distance_transform_edt(~core, return_distances=False, return_indices=True)
    seen = printed & (read | dark[rows, columns] & ~tinted)
    paper = ~printed & ~tinted & ~on_plate
    weight = paper * np.power(light.mean(axis=2), 4)
    sigma = _PAPER_AROUND / pixel
    total = cv2.GaussianBlur(weight.astype(np.float32), (0, 0), sigma)[..., None]
    mean = cv2.GaussianBlur((weight[..., None] * light).astype(np.float32), (0, 0), sigma)
    mean = np.where(total > 1e-6, mean / np.maximum(total, 1e-6), 1.0)
    return np.where(seen[..., None], mean, light).astype(np.float32), None
