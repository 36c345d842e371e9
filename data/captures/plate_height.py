"""The height of a plate over the mat, from several pictures of the cloth on it.

Rectified to the plane of the plate, pictures show threads, prints and creases of the cloth on it in
the same places. If it lies higher or lower than stated, over the mat as it is printed, they move
with the camera's place (parallax). The hem tells less: another scale changes its radius and depth
as another stiffness does.
"""

from collections.abc import Sequence
from itertools import combinations

import cv2
import numpy as np

from common.types import Metres
from data.captures.scale import Scaled
from data.pictures.planes import shifted
from sim.rig import Rig

MAX_OFF = 0.03  # of the stated height; focal lengths are stated to 1.5 %
_MOVED = 1e-3  # m, in the plane of the plate, that errors of poses explain
_UNLIKE, _UNLIKE_RIM = 0.1, 0.05  # correlation at another height less that at the stated one
_OFF = np.arange(-25, 26) * 1e-3  # m, heights over the stated one that are tried
_AS_STATED = (_OFF > -0.02) & (_OFF <= 0)  # cloth hangs beside the rim
_FARTHEST = 0.012  # m, of a move
_STEP, _FINE, _COARSE = 4e-4, 1.0, 4.0  # m, and pixels: deviations that structure lies between
_TOP, _RIM = np.array([0.0, 0.97]), np.array([1.02, 1.06])  # of the plate's radius, compared


def height_off(views: Sequence[Scaled], rig: Rig, plate_height: Metres) -> Metres | None:
    """How much higher than stated over the mat the cloth on the plate lies, as pictures show; None
    if they agree with what is stated, or show too little.

    An upper disc lies on the cloth, too; but cloth beside it hangs down, where that on a mat which
    is printed too small is still as high."""
    half = _RIM[1] * rig.plate_radius + _FARTHEST
    seen = [(_structure(view, half), view.beside / view.height)
            for view in views if view.beside is not None]
    if len(seen) < 2:
        return None

    def alike(part: np.ndarray) -> np.ndarray:
        """Mean correlation at each height, and last at the stated one."""
        return np.mean([_alike(one, other, second - first, part * rig.plate_radius)
                        for (one, first), (other, second) in combinations(seen, 2)], axis=0)

    *curve, stated = alike(_TOP)
    best = int(np.argmax(curve))
    off, told = float(_OFF[best]), curve[best] - stated >= _UNLIKE and 0 < best < len(_OFF) - 1
    if told and off > 0:
        rim = alike(_RIM)[:-1]
        told = rim[best - 2 : best + 3].max() - rim[_AS_STATED].max() >= _UNLIKE_RIM
    return off if told and abs(off) > MAX_OFF * plate_height else None


def _structure(view: Scaled, half: Metres) -> np.ndarray:
    """What is light and dark (N, N) beside its neighbours up to ``half`` from the plate's centre,
    at its stated height."""
    count = 2 * int(half / _STEP) + 1
    to_metres = np.diag([_STEP, -_STEP, 1.0]) @ shifted(np.full(2, (1 - count) / 2))
    light = np.log(view.photograph.grey.astype(np.float32) + 8)  # noise of dark cloth
    light = cv2.warpPerspective(light, np.linalg.inv(view.to_metres) @ to_metres, (count, count),
                                flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP)
    return cv2.GaussianBlur(light, (0, 0), _FINE) - cv2.GaussianBlur(light, (0, 0), _COARSE)


def _alike(
    one: np.ndarray, other: np.ndarray, towards: np.ndarray, within: np.ndarray
) -> np.ndarray:
    """Correlation (N + 1,) of two structures at each height, and at the stated one, between the
    radii ``within`` (2,), m; what lies higher moves against ``towards`` (2,) times its height."""
    steps = (np.arange(len(one)) - (len(one) - 1) / 2) * _STEP
    radius = np.hypot(steps, steps[:, None])
    most, moved = int(_FARTHEST / _STEP), int(_MOVED / _STEP)
    inner, here = (slice(most, -most),) * 2, (slice(most - moved, most + moved + 1),) * 2
    compared = ((radius >= within[0]) & (radius < within[1])).astype(np.float32)
    found = np.nan_to_num(cv2.matchTemplate(other, one[inner], cv2.TM_CCORR_NORMED,
                                            mask=compared[inner]), posinf=0, neginf=0)
    columns, rows = (most + np.outer([-1, 1], _OFF) * towards[:, None] / _STEP).astype(np.float32)
    curve = cv2.remap(cv2.dilate(found, np.ones((3, 3))), columns, rows, cv2.INTER_LINEAR,
                      borderMode=cv2.BORDER_CONSTANT, borderValue=-1)
    return np.append(curve.ravel(), found[here].max())
