"""Directions in which a drape is described by its distance from a point on the plate's axis."""

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
    depth = -centre_height(rig)
    return np.linspace(np.arctan2(depth - rig.overhang, _UNDER * rig.plate_radius),
                       np.arctan2(depth, rig.plate_radius), ELEVATIONS + 1)


def binned(
    points: Points, turn: Radians, rig: Rig, columns: int, rows: int
) -> tuple[np.ndarray, np.ndarray]:
    """Sums (columns, rows) of weighted distances, m, and of weights of one view's points."""
    radius, height = np.hypot(points[:, 0], points[:, 1]), points[:, 2] - centre_height(rig)
    low, *_, high = elevations(rig)
    row = (np.arctan2(height, radius) - low) * (rows / (high - low))
    inside = (row >= 0) & (row < rows)
    azimuth = np.arctan2(points[inside, 1], points[inside, 0])
    column = np.floor((azimuth - turn) * (columns / (2 * np.pi))).astype(int) % columns
    cell = column * rows + row[inside].astype(int)
    facing = np.maximum(-np.sin(azimuth), _MIN_FACING) ** 2  # the camera is at -y
    distance = np.hypot(radius[inside], height[inside])
    return tuple(np.bincount(cell, values, minlength=columns * rows).reshape(columns, rows)
                 for values in (facing * distance, facing))
