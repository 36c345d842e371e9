"""What the network that cuts cloth out of photographs is given: the picture in the plane of the
plate, what is printed on a mat as it must appear there, and the distance from the plate's axis."""

from dataclasses import dataclass

import numpy as np

from common.types import ColourPicture, Mask, Metres
from data.pictures.reading import decoded

SIDE = 128  # pixels
AROUND = 1.2  # of the flat specimen's reach, shown
FINE, COARSE = 4, 5  # inputs at each pixel, and at each square of two by two
_FLOOR = 0.02  # of light
_BRIGHT = 0.95  # quantile of the light that becomes 1
_LIGHT = decoded(np.arange(256) / 255.0)


def steps(reach: Metres) -> np.ndarray:
    """Places (SIDE,), m, of the pixels along x, and upwards along y."""
    return ((np.arange(SIDE) + 0.5) / SIDE * 2 - 1) * AROUND * reach


@dataclass(frozen=True)
class View:
    """Pictures of SIDE x SIDE pixels about the plate's axis, x to the right, y up.

    Attributes:
        picture: (SIDE, SIDE, 3).
        printed: (SIDE, SIDE) uint8, the mat as it would be seen without a drape; 0 beside it.
        on_mat, unseen: where the mat is, covered or not; where there is no picture.
        plate, reach: radii of the plate and of the flat specimen.
        off: (2,) m, place of the middle from the plate's axis; None if that is not known.
    """

    picture: ColourPicture
    printed: np.ndarray
    on_mat: Mask
    unseen: Mask
    plate: Metres
    reach: Metres
    off: np.ndarray | None

    def channels(self) -> tuple[np.ndarray, np.ndarray]:
        """Inputs (FINE, SIDE, SIDE) and (COARSE, SIDE/2, SIDE/2) of the network, float32."""
        light = _LIGHT[self.picture]
        bright = max(float(np.quantile(light[~self.unseen].max(axis=1), _BRIGHT)), 1e-3)
        logs = np.log(light / bright + _FLOOR)
        logs[self.unseen] = 0.0
        fine = np.stack([*np.moveaxis(logs, 2, 0), self.printed / 255.0]).astype(np.float32)
        known, far = 0.0, np.zeros((SIDE, SIDE))
        if self.off is not None:
            along = steps(self.reach)
            known, far = 1.0, np.hypot(along + self.off[0], (-along + self.off[1])[:, None])
        coarse = [self.on_mat, self.unseen, np.full((SIDE, SIDE), known),
                  known * (far / self.plate - 1), known * (far / self.reach - 1)]
        half = [np.asarray(one, np.float32).reshape(SIDE // 2, 2, SIDE // 2, 2).mean((1, 3))
                for one in coarse]
        return fine, np.stack(half)
