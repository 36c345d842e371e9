"""What of a hem is not clearly seen in pictures from above, and from where another may show it;
where it bulges, and the sides of a picture in words, x to its right, y up in it.

A shadow or a sheet of paper that is read as cloth fills the valleys between folds. Of a drape with
many folds, each is narrow; only a stiff cloth has few, wide ones: a bulge is a part of an outline
that stands out over more of the azimuth than folds of that drape can.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import minimum_filter1d

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
_ORDERS = np.arange(2, 21)  # of waves around the outline; the first is of a specimen off its centre
_FLAT = 2e-3  # deviation over the mean, of a specimen without folds
_FOLDS = (3.5, 5.5, 7.0, 12.0)
_LIMITS = {12: (1.6, 1.4, 0.9, 0.5), 8: (1.25, 1.0, 0.6, 0.1)}
"""By how many standard deviations of the radius all of an arc may stand out, for mean orders of an
outline's waves of ``_FOLDS``; the key is how often the arc goes around. Three of 1 000 simulated
outlines have more, and none of 309 real ones."""
DOUBTFUL, MAX_DOUBTFUL = 3e-3, 0.05  # m, error of a hem, and the share of it that may have more
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


def bulge(radii: np.ndarray) -> list[Finding]:
    """A warning if an arc of a hem bulges, of radii (A,) at equally spaced azimuths from x on."""
    waves = np.fft.rfft(radii)
    waves[:2] = 0
    away, power = np.fft.irfft(waves, len(radii)), np.abs(waves[_ORDERS]) ** 2
    if away.std() < _FLAT * radii.mean():
        return []
    folds, found = power @ _ORDERS / power.sum(), []
    for share, limits in _LIMITS.items():
        least = minimum_filter1d(away, len(radii) // share, mode="wrap")
        value = least.max() / away.std()
        found.append((value - np.interp(folds, _FOLDS, limits), least.argmax()))
    excess, place = max(found)
    if excess <= 0:
        return []
    return [Finding("hem_bulges", {"place": f"at the {side(2 * np.pi * place / len(radii))}"})]


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
