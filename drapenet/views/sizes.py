"""Sizes of specimen and plate, measured on the captured cloth.

    points of all views -> sections through the axis -> lengths to the hem, radii of the flat part

Cloth bends almost without stretching: a section from the axis to the hem of a disc is as long as
its radius where a fold has its crest or its valley, and little longer between them. For a
rectangle, these lengths run from half a side to half a diagonal.
"""

from dataclasses import dataclass

import numpy as np

from common.types import Metres
from drapenet.views.directions import AZIMUTH, AZIMUTHS, centre_height
from drapenet.views.located import LocatedViews
from sim.rig import SQUARE_RIG, Rig

_ROWS = 48  # of elevation, from the zenith down: coarse, as noise makes a section longer
_MIN_DEPTH = 0.4  # of the plate's radius, of the point below the plate that sections are seen from
_MIN_PIXELS = 2  # of a cell
_MIN_CELLS = 4  # of a section
_MIN_SHARE = 0.25  # of the sections must be seen
_MAX_GAP = 0.018, 0.25  # m, or of the overhang: in a section, cloth may be hidden in a larger one
_INNER = 0.5  # of the plate's radius, within which sections are taken as flat
_BEYOND = 1.05  # of the plate's radius: shorter sections end at the rim, the cloth below is hidden
_FALLS = 1.5e-3, 6e-3  # m below the plate's plane, where the radius is measured
TYPICAL = {"disc": (0.5, 0.957), "square": (0.8, 1.27)}
"""Quantile of the sections' lengths that varies least between drapes, and its median over drapes,
in half sizes: the cells at the hem are seen only in part. For rectangles see :func:`typical`."""
TYPICAL_PLATE = 0.934
"""Median of the measured over the true radius of a plate: cells are large, and its rim is round."""


@dataclass(frozen=True)
class Sizes:
    """Measured sizes, m, of a capture of the tester ``rig``; NaN where too little is seen."""

    specimen: Metres  # side of a square, :attr:`sim.rig.Rig.specimen_size` of others
    plate: Metres  # diameter
    rig: Rig
    views: int  # their number; a single view may show few corners of a square, or few of its sides


def measured_sizes(located: LocatedViews) -> Sizes:
    """Sizes of a capture's specimen, of the shape of its stated tester, and plate."""
    rig = located.rig
    longest_step = max(_MAX_GAP[0], _MAX_GAP[1] * rig.overhang)
    lengths, rims = [], []
    for radius, height in zip(*_sections(located), strict=True):
        seen = np.isfinite(radius)
        hanging = seen & (radius > _INNER * rig.plate_radius)
        if hanging.sum() < _MIN_CELLS:
            continue
        rims.append(_rim(radius[seen], height[seen]))
        steps = np.hypot(np.diff(radius[hanging]), np.diff(height[hanging]))
        length = radius[hanging][0] + steps.sum()
        if steps.max() < longest_step and length > _BEYOND * rig.plate_radius:
            lengths.append(length)
    quantile, median = typical(rig)
    top = 2 * _quantile(rims, 0.5) / TYPICAL_PLATE  # cloth begins to fall where a rim begins
    return Sizes(2 * _quantile(lengths, quantile) / median, top + 2 * rig.rim, rig,
                 len(located.views))


def typical(rig: Rig) -> tuple[float, float]:
    """The values of :data:`TYPICAL` for the shape of ``rig``: of a rectangle, those of a square,
    times the ratio of that quantile of the flat specimens."""
    if rig.specimen != "rectangle":
        return TYPICAL[rig.specimen]
    quantile, median = TYPICAL["square"]
    flat, square = (np.quantile(one.border(AZIMUTH) / one.specimen_size, quantile)
                    for one in (rig, SQUARE_RIG))
    return quantile, median * float(flat / square)


def _sections(located: LocatedViews) -> tuple[np.ndarray, np.ndarray]:
    """(AZIMUTHS, _ROWS) m, mean distance from the axis and mean height above the plate of the cloth
    by azimuth and elevation, from the zenith down; NaN where it is not seen."""
    shape = (AZIMUTHS, _ROWS)
    total = np.zeros((3, AZIMUTHS * _ROWS))
    rig = located.rig
    depth = max(-centre_height(rig), _MIN_DEPTH * rig.plate_radius)
    for cloud, turn in zip(located.clouds, located.turns, strict=True):
        x, y, height = (cloud - [*located.centre, 0.0]).T
        radius = np.hypot(x, y)
        elevation = np.arctan2(height + depth, radius)
        row = np.minimum((0.5 - elevation / np.pi) * _ROWS, _ROWS - 1).astype(int)
        column = np.floor((np.arctan2(y, x) - turn) * (AZIMUTHS / (2 * np.pi))).astype(int)
        cell = column % AZIMUTHS * _ROWS + row
        total += [np.bincount(cell, values, minlength=total.shape[1])
                  for values in (np.ones(len(cell)), radius, height)]
    pixels = np.where(total[0] >= _MIN_PIXELS, total[0], np.nan)
    return (total[1] / pixels).reshape(shape), (total[2] / pixels).reshape(shape)


def _rim(radius: np.ndarray, height: np.ndarray) -> float:
    """Distance from the axis, m, where a section (N,) begins to fall: where a parabola through its
    first points at both of _FALLS has its vertex. NaN if it falls less."""
    lowest = np.minimum.accumulate(height)
    if lowest[-1] > -_FALLS[1]:
        return np.nan
    # Heights are a quarter of each other, so that the vertex is as far from one as from the other.
    near, far = np.interp(_FALLS, -lowest, radius)
    return 2 * near - far


def _quantile(values: list[float], quantile: float) -> float:
    """A quantile of finite values; NaN if fewer than _MIN_SHARE of the azimuths have one."""
    finite = np.array(values)[np.isfinite(values)]
    return float(np.quantile(finite, quantile)) if len(finite) > _MIN_SHARE * AZIMUTHS else np.nan
