"""Initial state on captured points, so that the simulated cloth has the captured folds.

The points give the surface's distance in each direction from a point on the axis. Every point of
the specimen is placed on it at its azimuth, at its arc length from the plate's rim: strained and
bent locally, but with the captured folds.
"""

import numpy as np
from scipy.interpolate import RegularGridInterpolator
from scipy.ndimage import gaussian_filter

from common.types import Metres, Points, Radians, RestPoints
from drapenet.views.radial_map import smoothed
from sim.rig import Rig

AZIMUTHS, ELEVATIONS = 120, 72
CENTRE = -0.06  # m, height of the point that the drape is seen from
STEP = 2e-3  # m, along the traced curves
_SIGMAS = (0.7, 2.0, 6.0, 20.0)  # cells, of the Gaussians that smooth and fill the surface
_LOWEST = -np.pi / 3  # elevation of the lowest direction
_ROWS = _LOWEST + (np.arange(ELEVATIONS) + 0.5) * (np.pi / 2 - _LOWEST) / ELEVATIONS


def _directions(points: Points) -> tuple[np.ndarray, np.ndarray]:
    """Distance of the surface from the centre by direction (AZIMUTHS, ELEVATIONS), m, without gaps,
    smooth; and elevation (AZIMUTHS,), rad, of the hem.
    """
    radius, height = np.hypot(points[:, 0], points[:, 1]), points[:, 2] - CENTRE
    azimuth = np.arctan2(points[:, 1], points[:, 0]) / (2 * np.pi) % 1 * AZIMUTHS
    elevation = np.arctan2(height, radius)
    row = (elevation - _LOWEST) / (np.pi / 2 - _LOWEST) * ELEVATIONS
    cells = azimuth.astype(int) % AZIMUTHS, row.astype(int).clip(0, ELEVATIONS - 1)
    total, count = np.zeros((2, AZIMUTHS, ELEVATIONS))
    np.add.at(total, cells, np.hypot(radius, height))
    np.add.at(count, cells, 1.0)
    visible = count > 0
    distance = smoothed(total / np.maximum(count, 1), visible, _SIGMAS, least=0.1)
    cloth = gaussian_filter(visible.astype(float), 0.7, mode=("wrap", "nearest")) > 0.3
    lowest = np.where(cloth.any(axis=1), cloth.argmax(axis=1), ELEVATIONS)
    return distance, _LOWEST + lowest * (np.pi / 2 - _LOWEST) / ELEVATIONS


def surface_positions(rest: RestPoints, points: Points, rig: Rig) -> np.ndarray:
    """Positions (V, 3), m, of rest points laid on the surface through ``points``, in the axes of
    the specimen."""
    distance, hem = _directions(points)
    plate = rig.plate_radius
    beyond = np.linalg.norm(rest, axis=1) - plate
    arcs = np.arange(0, beyond.max() + 2 * STEP, STEP)
    curves = np.stack([_curve(*row, plate, arcs) for row in zip(distance, hem, strict=True)])
    # Around the circle, with the first azimuth repeated behind the last.
    grid = 2 * np.pi * (np.arange(-1, AZIMUTHS + 1) + 0.5) / AZIMUTHS
    look_up = RegularGridInterpolator(
        (grid, arcs), np.concatenate([curves[-1:], curves, curves[:1]]), bounds_error=False,
        fill_value=None)
    azimuth = np.arctan2(rest[:, 1], rest[:, 0]) % (2 * np.pi)
    radius, height = look_up(np.column_stack([azimuth, np.maximum(beyond, 0.0)])).T
    placed = np.column_stack([radius * np.cos(azimuth), radius * np.sin(azimuth), height])
    inside = beyond <= 0
    placed[inside] = rig.place(rest[inside])
    return placed


def _curve(distance: np.ndarray, hem: Radians, plate: Metres, arcs: np.ndarray) -> np.ndarray:
    """Radius and height (A, 2), m, at arc lengths (A,) from the rim along one azimuth."""
    radius = distance * np.cos(_ROWS)
    height = distance * np.sin(_ROWS) + CENTRE
    down = (radius > plate) & (_ROWS > hem) & (_ROWS < np.arctan2(-CENTRE, plate))
    radius = np.concatenate([[plate], radius[down][::-1]])
    height = np.concatenate([[0.0], np.minimum(height[down][::-1], 0.0)])
    length = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(radius), np.diff(height)))])
    # Extrapolate beyond the hem with the slope of the last two centimetres.
    end = length[-1]
    back = max(end - 0.02, 0.0)
    slope = (np.array([radius[-1] - np.interp(back, length, radius),
                       height[-1] - np.interp(back, length, height)]) / (end - back)
             if end > 0 else np.array([0.0, -1.0]))
    curve = np.column_stack([np.interp(arcs, length, radius), np.interp(arcs, length, height)])
    return curve + np.maximum(arcs - end, 0.0)[:, None] * slope
