"""Directions in which a drape is described by its distance from a point on the plate's axis."""

import math
from dataclasses import dataclass

import numpy as np

from common.types import Metres, Points, Radians
from sim.rig import Rig

AZIMUTHS, ELEVATIONS = 128, 48
AZIMUTH = (np.arange(AZIMUTHS) + 0.5) * (2 * np.pi / AZIMUTHS)
"""(AZIMUTHS,) rad, middles of the columns."""
_UNDER = 0.9  # of the plate's radius, smallest radius of hanging cloth in the map
_DEPTH = 0.6  # of the centre below the plate, in overhangs
_MIN_FACING = 0.15  # minimum cosine in the weight of a pixel


def centre_height(rig: Rig) -> Metres:
    """Height of the point that a drape is seen from, relative to the plate, negative."""
    return -_DEPTH * (rig.specimen_size - rig.plate_diameter) / 2


def elevations(rig: Rig) -> np.ndarray:
    """(R,) rad, borders of the rows from the lowest possible hem to the rim."""
    return np.linspace(*_limits(rig), ELEVATIONS + 1)


def _limits(rig: Rig) -> tuple[Radians, Radians]:
    """Elevations of the lowest possible hem and of the rim."""
    depth = -centre_height(rig)
    return (math.atan2(depth - rig.overhang, _UNDER * rig.plate_radius),
            math.atan2(depth, rig.plate_radius))


@dataclass(frozen=True)
class Polar:
    """Points of one view seen from the point on the axis, (N,) each.

    Attributes:
        azimuth: rad, in the axes of the camera, which is at -y.
        level: place among the rows of a map, from 0 at its lowest border to 1 at the rim.
        distance: m.
        weight: of the point in a cell, larger where it faces the camera.
    """

    azimuth: np.ndarray
    level: np.ndarray
    distance: np.ndarray
    weight: np.ndarray

    @classmethod
    def of(cls, points: Points, centre: np.ndarray, rig: Rig) -> "Polar":
        """Of points whose axis is at ``centre`` (2,), m."""
        x, y = points[:, 0] - centre[0], points[:, 1] - centre[1]
        height = points[:, 2] - centre_height(rig)
        radius = np.sqrt(x * x + y * y)
        low, high = _limits(rig)
        facing = np.maximum(-y / np.maximum(radius, 1e-300), _MIN_FACING)
        return cls(np.arctan2(y, x), (np.arctan2(height, radius) - low) / (high - low),
                   np.sqrt(radius * radius + height * height), facing * facing)

    def binned(self, turn: Radians, columns: int, rows: int) -> tuple[np.ndarray, np.ndarray]:
        """Sums (columns, rows) of weighted distances, m, and of weights, by direction from a
        ``turn`` on."""
        place = self.level * rows
        shown = (place >= 0) & (place < rows)
        column = np.floor((self.azimuth[shown] - turn) * (columns / (2 * np.pi))).astype(int)
        cell = column % columns * rows + place[shown].astype(int)
        weight = self.weight[shown]
        total, weights = (np.bincount(cell, values, columns * rows).reshape(columns, rows)
                          for values in (weight * self.distance[shown], weight))
        return total, weights
