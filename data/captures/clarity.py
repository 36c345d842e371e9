"""What of a hem is not clearly seen in pictures from above, and from where another may show it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from common.findings import Finding
from common.types import Radians, Vector
from data.captures.ground import Ground
from data.captures.joined_outlines import around
from data.captures.off_axis import AZIMUTHS, MAX_LEAN
from data.captures.sides import side, sides

DOUBTFUL, MAX_DOUBTFUL = 3e-3, 0.05  # m, error of a hem, and the share of it that may have more
MAX_ALONG_BORDER = 0.2  # of the azimuth; 3 of 19 sound pictures with the mat a3 have more


@dataclass(frozen=True)
class Clarity:
    """Where a hem is not clear, at 720 equally spaced azimuths.

    Attributes:
        doubtful: (720,) where its error is large.
        bordering: (720,) where the border of the mat's paper, for whose edge it may be taken, is
            seen along it.
        ground: of the pictures; None without a mat.
    """

    doubtful: np.ndarray
    bordering: np.ndarray
    ground: Ground | None

    @classmethod
    def of(
        cls, radii: np.ndarray, error: np.ndarray, cameras: Sequence[Vector], ground: Ground | None
    ) -> "Clarity":
        """In one picture over a mat, or without one, of radii and their errors (720,), m."""
        bordering = (np.zeros(AZIMUTHS, bool) if ground is None else
                     ground.along_border(radii, cameras[0]))
        return cls(error > DOUBTFUL, bordering, ground)

    @classmethod
    def together(cls, pictures: Sequence["Clarity"]) -> "Clarity":
        """In several pictures: what is not clear in most of them."""
        doubtful, bordering = (np.mean(masks, axis=0) > 0.5 for masks in zip(
            *((one.doubtful, one.bordering) for one in pictures), strict=True))
        return cls(doubtful, bordering, pictures[0].ground)

    def turned(self, angle: Radians) -> "Clarity":
        """The same, turned counter-clockwise."""
        doubtful, bordering = (around(mask.astype(float), -angle) > 0.5
                               for mask in (self.doubtful, self.bordering))
        return Clarity(doubtful, bordering, self.ground)

    @property
    def unclear(self) -> np.ndarray:
        """Where (720,) the hem is not clear, of so large a part that it counts."""
        return ((self.doubtful & (self.doubtful.mean() > MAX_DOUBTFUL))
                | (self.bordering & (self.bordering.mean() > MAX_ALONG_BORDER)))

    def judged(
        self, radii: np.ndarray, cameras: Sequence[Vector]
    ) -> tuple[Vector | None, list[Finding]]:
        """The place (3,), m from the plate's centre, from which another picture over the mat is
        asked for, None if none is; and warnings of a hem of ``radii`` (720,), m, that ``cameras``
        have seen, of one camera also where it may be hidden."""
        doubted, bordered = float(self.doubtful.mean()), float(self.bordering.mean())
        unclear = self.unclear
        x, y, height = cameras[0] if len(cameras) == 1 else (0.0, 0.0, 1.0)
        lean = float(np.hypot(x, y) / height)
        if not unclear.any() and lean <= MAX_LEAN:
            return None, []
        place, where, behind = None, "another side", "its ground"
        if self.ground is not None:
            place = self.ground.next_camera(radii, unclear, cameras)
            where = _in_words(place)
        warnings = []
        if bordered > MAX_ALONG_BORDER:
            warnings.append(Finding("hem_along_border", {
                "value": bordered, "limit": MAX_ALONG_BORDER, "place": sides(self.bordering),
                "next": where}))
        if doubted > MAX_DOUBTFUL:
            if self.ground is not None:
                behind = self.ground.kind(radii, self.doubtful, cameras[-1])
            warnings.append(Finding("hem_doubtful", {
                "value": doubted, "limit": MAX_DOUBTFUL, "place": sides(self.doubtful),
                "ground": behind, "next": where}))
        if lean > MAX_LEAN:
            warnings.append(Finding("camera_beside", {
                "value": lean, "limit": MAX_LEAN, "beside": 1e3 * float(np.hypot(x, y)),
                "height": 1e3 * float(height), "next": where,
                "place": f"at the {side(float(np.arctan2(-y, -x)))}"}))
        return place, warnings


def _in_words(camera: Vector) -> str:
    """A place (3,), m from the plate's centre, to a centimetre."""
    beside, above = (10 * round(1e2 * float(length))
                     for length in (np.hypot(*camera[:2]), camera[2]))
    if not beside:
        return f"{above} mm straight above the plate's centre"
    towards = side(float(np.arctan2(camera[1], camera[0])))
    return f"{above} mm above the plate, {beside} mm to the {towards} of its centre"
