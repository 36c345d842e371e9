"""Reader of measured deflection curves of cantilever strips, in CSV files."""

import re
from pathlib import Path

import numpy as np

from common.errors import InputError
from common.tables import number, read_table
from common.types import DeflectionCurve

COLUMNS = ("x_mm", "y_mm")
MIN_POINTS = 12
MAX_FILE_SIZE = 1 << 20  # bytes
MIN_SPAN, MAX_SPAN = 5e-3, 2.0  # m
MIN_UPWARD_BEND = 0.05
"""Quadratic coefficient of a parabola fitted to a curve, in units of the chord; reading errors
of a nearly straight strip are smaller."""


def read_curve(path: str | Path) -> DeflectionCurve:
    """Read a curve from a CSV file whose header names the columns x_mm and y_mm, or x [mm], y [mm].

    The first row is the clamp's edge, the last the free end. The signs of both axes are arbitrary,
    because a strip extends away from its clamp and hangs below it.
    """
    path = Path(path)
    header, rows = read_table(path, "deflection curve", MAX_FILE_SIZE)
    header = [re.sub(r"[^a-z]+", "_", name.lower()).strip("_") for name in header]
    if not set(COLUMNS) <= set(header):
        raise InputError(f"{path} needs a header line with the columns {' and '.join(COLUMNS)}, "
                         "separated by commas, semicolons or tabs")
    x, y = (header.index(name) for name in COLUMNS)
    points = []
    for line, row in rows:
        try:
            points.append((number(row[x]), number(row[y])))
        except (ValueError, IndexError):
            raise InputError(f"{path}, line {line}: expected numbers, in mm") from None
    try:
        return oriented_curve(np.array(points).reshape(-1, 2) * 1e-3)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def oriented_curve(points: np.ndarray) -> DeflectionCurve:
    """The curve through ``points`` (N, 2), m, moved to start at 0, with positive reach and drop;
    InputError unless it has the size and shape of a hanging strip."""
    if (places := len(np.unique(points, axis=0))) < MIN_POINTS:
        raise InputError(f"the curve has {places} different points; give at least "
                         f"{MIN_POINTS}")
    if not np.isfinite(points).all():
        raise InputError("all coordinates must be finite numbers")
    curve = points - points[0]
    length = np.linalg.norm(np.diff(curve, axis=0), axis=1).sum()
    span = np.linalg.norm(np.ptp(curve, axis=0))
    if not MIN_SPAN <= span <= MAX_SPAN:
        raise InputError(f"the curve spans {1e3 * span:.6g} mm but strips have "
                         f"{1e3 * MIN_SPAN:g} to {1e3 * MAX_SPAN:g} mm; give its columns in mm")
    reach, drop = curve[-1]
    if abs(reach) < 1e-3 * span or drop == 0:
        raise InputError(f"the free end is at ({1e3 * reach:.3g}, {1e3 * drop:.3g}) mm from the "
                         "clamp's edge; it must lie beside and below it: check the columns")
    # A smooth hanging strip is at most as long as reach + drop.
    if length > 3 * (abs(reach) + abs(drop)):
        raise InputError("the points are out of order; list them from the clamp to the free end")
    curve = curve * np.sign([reach, drop])
    if _bends_up(curve):
        raise InputError("the curve is steep at its first point and level at its last; list the "
                         "points from the clamp's edge to the free end")
    return curve


def _bends_up(curve: DeflectionCurve) -> bool:
    """Whether a curve significantly bends up, as one listed from the free end to the clamp."""
    x, y = curve[-1] / np.linalg.norm(curve[-1]) ** 2
    along, below = curve @ [x, y], curve @ [-y, x]
    (bend, _, _), covariance = np.polyfit(along, below, 2, cov=True)
    return bool(-bend > max(MIN_UPWARD_BEND, 4 * np.sqrt(covariance[0, 0])))
