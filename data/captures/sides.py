"""Sides of a picture from above in words, x to its right, y up in it."""

import numpy as np

from common.types import Radians

_SIDES = ("right", "upper right", "upper side", "upper left", "left", "lower left", "lower side",
          "lower right")
_GAP = np.radians(20.0)  # between parts that are of one
_MOST = 0.6  # of the azimuth, beyond which it is all around
_SMALL = 0.25  # of the largest part, below which another is not named
_NAMED = 3  # parts, at most


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
