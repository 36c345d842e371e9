"""What of a hem is not clearly seen in pictures from above, and from where another may show it;
where it is not one of cloth, and the sides of a picture in words, x to its right, y up in it.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from common.findings import Finding
from common.types import Radians, Vector
from data.captures.ground import Ground
from data.captures.joined_outlines import around
from data.captures.off_axis import AZIMUTHS, MAX_LEAN

_SIDES = ("right", "upper right", "upper side", "upper left", "left", "lower left", "lower side",
          "lower right")
_GAP = np.radians(20.0)  # between parts that are of one
_MOST = 0.6  # of the azimuth, beyond which it is all around
_SMALL = 0.25  # of the largest part, below which another is not named
_NAMED = 3  # parts, at most
DOUBTFUL, MAX_DOUBTFUL = 3e-3, 0.05  # m, error of a hem, and the share of it that may have more
MAX_UNLIKE = 2.1e-3
"""m, rms error of a hem by its shape: 7 of 996 simulated outlines of fabrics held out, read with
0.2 to 0.5 mm, have more, of 309 real ones none, of rendered pictures that are read 2 mm rms or more
off 65 of 100, and one of 80 that are right."""
MAX_ALONG_BORDER = 0.2  # of the azimuth; 3 of 19 sound pictures with the mat a3 have more


def side(azimuth: Radians) -> str:
    """The side of a picture in a direction from its middle."""
    return _SIDES[round(azimuth / (np.pi / 4)) % 8]


def sides(where: np.ndarray) -> str:
    """Where a part of a hem lies, such as "at the lower left and right"; ``where``: (A,) of
    equally spaced azimuths, of which at least one is true."""
    count = len(where)
    places = np.flatnonzero(where)
    steps = np.diff(places, append=places[0] + count)
    ends = np.flatnonzero(steps > _GAP / (2 * np.pi) * count)
    if where.mean() > _MOST or not len(ends):
        return "all around"
    parts = []
    for before, end in zip(np.roll(ends, 1), ends, strict=True):
        first, last = places[(before + 1) % len(places)], places[end]
        inside = np.arange(first, last + 1 + count * (last < first)) % count
        parts.append((int(where[inside].sum()), float(first + (len(inside) - 1) / 2)))
    parts.sort(reverse=True)
    names = list(dict.fromkeys(side(2 * np.pi * middle / count) for size, middle in parts[:_NAMED]
                               if size >= _SMALL * parts[0][0]))
    return "at the " + " and ".join([", ".join(names[:-1])] * (len(names) > 1) + names[-1:])


def jagged_hem(unlike: np.ndarray, following: str = "another side") -> list[Finding]:
    """A warning where a hem has a shape that cloth has not, so that its radii are ``unlike``
    (A,), m, those of cloth; and from where another picture is asked for."""
    return [] if not (jagged := _jagged(unlike)).any() else [Finding("hem_jagged", {
        "value": 1e3 * _rms(unlike), "limit": 1e3 * MAX_UNLIKE, "share": float(jagged.mean()),
        "place": sides(jagged), "next": following})]


def _jagged(unlike: np.ndarray) -> np.ndarray:
    return (unlike > MAX_UNLIKE) & (_rms(unlike) > MAX_UNLIKE)


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.square(values).mean()))


@dataclass(frozen=True)
class Clarity:
    """Where a hem is not clear, at 720 equally spaced azimuths.

    Attributes:
        doubtful: (720,) where its error is large.
        unlike: (720,) m, its error by its shape (:mod:`data.captures.hem`).
        bordering: (720,) where the border of the mat's paper, for whose edge it may be taken, is
            seen along it.
        ground: of the pictures; None without a mat.
    """

    doubtful: np.ndarray
    unlike: np.ndarray
    bordering: np.ndarray
    ground: Ground | None

    @classmethod
    def of(
        cls, radii: np.ndarray, error: np.ndarray, unlike: np.ndarray, cameras: Sequence[Vector],
        ground: Ground | None
    ) -> "Clarity":
        """In one picture over a mat, or without one, of radii and their errors (720,), m, as they
        were read and by their shape."""
        bordering = (np.zeros(AZIMUTHS, bool) if ground is None else
                     ground.along_border(radii, cameras[0]))
        return cls(error > DOUBTFUL, unlike, bordering, ground)

    @classmethod
    def together(cls, pictures: Sequence["Clarity"]) -> "Clarity":
        """In several pictures: what is not clear in most of them."""
        doubtful, bordering = (np.mean(masks, axis=0) > 0.5 for masks in zip(
            *((one.doubtful, one.bordering) for one in pictures), strict=True))
        unlike = np.quantile([one.unlike for one in pictures], 0.5, axis=0, method="lower")
        return cls(doubtful, unlike, bordering, pictures[0].ground)

    def turned(self, angle: Radians) -> "Clarity":
        """The same, turned counter-clockwise."""
        doubtful, bordering = (around(mask.astype(float), -angle) > 0.5
                               for mask in (self.doubtful, self.bordering))
        return Clarity(doubtful, around(self.unlike, -angle), bordering, self.ground)

    @property
    def unclear(self) -> np.ndarray:
        """Where (720,) the hem is not clear, of so large a part that it counts."""
        return ((self.doubtful & (self.doubtful.mean() > MAX_DOUBTFUL))
                | _jagged(self.unlike)
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
        warnings += jagged_hem(self.unlike, where)
        if lean > MAX_LEAN:
            warnings.append(Finding("camera_beside", {
                "value": lean,
                "limit": MAX_LEAN,
                "beside": 1e3 * float(np.hypot(x, y)),
                "height": 1e3 * float(height),
                "next": where,
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
