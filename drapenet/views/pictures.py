"""Depth views as four pictures of one scale, the input of Feng et al. 2022.

The paper's camera is fixed; here a pixel is a share of the specimen's size at the plate's distance,
and depth is counted from the plate, so that pictures of all cameras and specimens are alike.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from common.types import Radians
from drapenet.views.located import LocatedViews

PICTURES, SIDE = 4, 128
"""Pictures of a capture, a quarter turn apart, and their height and width."""
_EXTENT, _BELOW = 1.3, 0.2  # of a picture, and of its centre below the plate's, in sizes
_QUARTER = np.pi / 2
_NEAR = np.radians(10.0)  # of a view's turn from a multiple of a quarter


@dataclass(frozen=True)
class DepthPictures:
    """Pictures of one capture.

    Attributes:
        depth: (PICTURES, SIDE, SIDE) float16, behind the plate's centre along the optical axis, in
            sizes of the specimen; NaN where no cloth is seen, and where there is no such view.
        angle: direction of azimuth 0 in the first picture, from -pi/4 to pi/4; in picture k it is k
            quarter turns more.
    """

    depth: np.ndarray
    angle: Radians

    @classmethod
    def of(cls, located: LocatedViews, zero: Radians) -> "DepthPictures":
        """The views, other than those between quarter turns; ``zero``: direction of azimuth 0 in
        the first view."""
        quarters = (zero + located.turns) / _QUARTER
        angle = (quarters[0] - round(quarters[0])) * _QUARTER
        apart = quarters - angle / _QUARTER
        depth = np.full((PICTURES, SIDE, SIDE), np.nan, np.float16)
        for view, place in zip(located.views, apart, strict=True):
            if abs(place - round(place)) * _QUARTER < _NEAR:
                depth[round(place) % PICTURES] = _picture(located, view)
        return cls(depth, float(angle))


def _picture(located: LocatedViews, view: np.ndarray) -> np.ndarray:
    """(SIDE, SIDE) means over the cloth of a depth view (H, W), m, in sizes."""
    size, camera = located.rig.specimen_size, located.camera
    (centre,), (away,) = camera.project(np.append(located.centre, 0.0)[None])
    half = max(round(_EXTENT * size * camera.fx / away / 2), 1)
    column = round(centre[0])
    row = round(centre[1] + _BELOW * size * camera.fy / away)
    # Read with a border without cloth, as wide as the part of the window outside the view.
    rows, columns = (np.clip(np.arange(middle - half, middle + half), -1, many)
                     for middle, many in ((row, len(view)), (column, view.shape[1])))
    cut = np.pad(view, 1)[np.ix_(rows + 1, columns + 1)].astype(np.float32)
    share, total = (cv2.resize(part, (SIDE, SIDE), interpolation=cv2.INTER_AREA)
                    for part in ((cut > 0).astype(np.float32), cut))
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(share > 0.5, (total / share - away) / size, np.nan)
