"""Deflection curves: reading them, and smoothing them by a Bézier curve.

Inside, a curve is an array (N, 2) of reach and drop in metres, from the clamp's edge to the free
end; the drop is positive downwards.
"""

import csv
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from scipy.special import comb

from common.errors import InputError, one_line

COLUMNS = ("x_mm", "y_mm")
FEWEST_POINTS = 12
LARGEST_FILE = 1 << 20  # bytes
SHORTEST, LONGEST = 5e-3, 2.0  # m
BENT_UP = 0.05
"""Quadratic coefficient of a parabola through a curve, in units of the chord of its ends, that no
error of reading a nearly straight strip makes."""
DEGREES = tuple(range(3, 15))
"""Degrees tried for a Bézier curve. A cubic one (section 4.3) cannot follow the curvature from the
clamp to the free end: it misreads alpha by 6 % at best (docs/validation.md)."""

_ROUNDS = 30


def read_curve(path: str | Path) -> np.ndarray:
    """Read a curve (N, 2), m, from a CSV file whose header names the columns x_mm and y_mm.

    The first row is the clamp's edge, the last the free end. The axes may point either way:
    a strip reaches away from its clamp and hangs below it.

    Raises:
        InputError: no such file, no such columns, a cell that is no number, too few points,
            points out of order or listed from the free end, or not the size and shape of a
            hanging strip.
    """
    path = Path(path)
    try:
        if path.stat().st_size > LARGEST_FILE:
            raise InputError(f"{path} is larger than 1 MB; a deflection curve is not")
        with path.open(newline="", encoding="utf-8-sig") as file:
            rows = [(reader.line_num, row) for reader in [csv.reader(file, skipinitialspace=True)]
                    for row in reader if any(cell.strip() for cell in row)]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        reason = getattr(error, "strerror", None) or one_line(error)
        raise InputError(f"cannot read the curve {path}: {reason}") from None
    header = [cell.strip() for cell in rows[0][1]] if rows else []
    if not set(COLUMNS) <= set(header):
        raise InputError(f"{path} needs a header line with the columns {' and '.join(COLUMNS)}, "
                         "separated by commas")
    x, y = (header.index(name) for name in COLUMNS)
    points = []
    for line, row in rows[1:]:
        try:
            points.append((float(row[x]), float(row[y])))
        except (ValueError, IndexError):
            raise InputError(f"{path}, line {line}: expected numbers, in mm") from None
    try:
        return oriented_curve(np.array(points).reshape(-1, 2) * 1e-3)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def oriented_curve(points: np.ndarray) -> np.ndarray:
    """A curve (N, 2), m, moved to start at 0 with reach and drop positive.

    Raises:
        InputError: as for :func:`read_curve`.
    """
    if (places := len(np.unique(points, axis=0))) < FEWEST_POINTS:
        raise InputError(f"{places} different points are too few; give {FEWEST_POINTS} or more")
    if not np.isfinite(points).all():
        raise InputError("all coordinates must be finite numbers")
    curve = points - points[0]
    length = np.linalg.norm(np.diff(curve, axis=0), axis=1).sum()
    span = np.linalg.norm(np.ptp(curve, axis=0))
    if not SHORTEST <= span <= LONGEST:
        raise InputError(f"a curve that spans {1e3 * span:.6g} mm is no strip's, "
                         f"{1e3 * SHORTEST:g} to {1e3 * LONGEST:g} mm; are its columns in mm?")
    reach, drop = curve[-1]
    if abs(reach) < 1e-3 * span or drop == 0:
        raise InputError("the free end must lie beside and below the clamp's edge")
    # A smooth hanging strip is at most reach + drop long; more is disorder.
    if length > 3 * (abs(reach) + abs(drop)):
        raise InputError("the points are out of order; list them from the clamp to the free end")
    curve = curve * np.sign([reach, drop])
    if _bends_up(curve):
        raise InputError("the curve begins steeply and ends level; list its points from the "
                         "clamp's edge to the free end")
    return curve


def _bends_up(curve: np.ndarray) -> bool:
    """Whether a curve (N, 2) of positive reach and drop surely bends up from its first point on.

    A strip's weight bends it down all along; listed from the free end to the clamp it bends up.
    """
    x, y = curve[-1] / np.linalg.norm(curve[-1]) ** 2
    along, below = curve @ [x, y], curve @ [-y, x]
    (bend, _, _), covariance = np.polyfit(along, below, 2, cov=True)
    return bool(-bend > max(BENT_UP, 4 * np.sqrt(covariance[0, 0])))


@dataclass(frozen=True)
class Bezier:
    """A plane Bézier curve.

    Attributes:
        control: (d + 1, 2) control points, m.
    """

    control: np.ndarray

    def at(self, t: np.ndarray, order: int = 0) -> np.ndarray:
        """(N, 2) values, or derivatives of that order, at parameters t (N,) in [0, 1]."""
        points = self.control
        for _ in range(order):
            points = (len(points) - 1) * np.diff(points, axis=0)
        return bernstein(t, len(points) - 1) @ points

    @cached_property
    def _lengths(self) -> tuple[np.ndarray, np.ndarray]:
        t = np.linspace(0.0, 1.0, 2049)
        speed = np.linalg.norm(self.at(t, 1), axis=1)
        steps = (speed[1:] + speed[:-1]) / 2 * np.diff(t)
        return t, np.concatenate([[0.0], np.cumsum(steps)])

    @property
    def length(self) -> float:
        """Arc length, m."""
        return float(self._lengths[1][-1])

    def evenly(self, count: int) -> np.ndarray:
        """(count,) parameters at equal arc lengths, ends included."""
        t, s = self._lengths
        return np.interp(np.linspace(0.0, s[-1], count), s, t)

    def curvature(self, t: np.ndarray) -> np.ndarray:
        """(N,) curvature, 1/m, positive where the strip bends down."""
        first, second = self.at(t, 1), self.at(t, 2)
        cross = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
        return cross / np.linalg.norm(first, axis=1) ** 3


def bernstein(t: np.ndarray, degree: int) -> np.ndarray:
    """(N, degree + 1) Bernstein polynomials at t (N,)."""
    k = np.arange(degree + 1)
    t = np.asarray(t, dtype=np.float64)[:, None]
    return comb(degree, k) * t**k * (1.0 - t) ** (degree - k)


def fit_bezier(
    curve: np.ndarray, *, degree: int | None = None, slope: float = 0.0
) -> tuple[Bezier, float]:
    """Least-squares Bézier curve that leaves the clamp's edge, 0, in the clamp's direction.

    Each point's parameter is moved to the nearest point of the fitted curve, and the fit
    repeated.

    Args:
        curve: (N, 2) m, reach and drop.
        degree: None for the one in :data:`DEGREES` with the least Bayesian information
            criterion, so that noise is not fitted.
        slope: angle of the clamp below the horizontal, radians.

    Returns:
        The curve and the root mean square distance of the points from it, m.

    Raises:
        InputError: fewer points than the degree needs.
    """
    if degree is not None:
        return _fit_degree(curve, degree, slope)
    best, least = None, np.inf
    count = len(curve)  # what counts is a point's distance across the curve
    scale = np.linalg.norm(curve[-1])
    for candidate in DEGREES:
        if 2 * (candidate + 1) > len(curve):
            break
        fit = _fit_degree(curve, candidate, slope)
        # Distances below 1e-6 of the curve's size are not told from each other.
        score = count * np.log(fit[1] ** 2 + (1e-6 * scale) ** 2) + 2 * candidate * np.log(count)
        if score < least:
            best, least = fit, score
    if best is None:
        raise InputError(f"{len(curve)} points are too few for a Bézier curve")
    return best


def _fit_degree(curve: np.ndarray, degree: int, slope: float) -> tuple[Bezier, float]:
    if degree < 2:
        raise InputError(f"a Bézier curve of degree {degree} cannot bend; give 2 or more")
    if 2 * (degree + 1) > len(curve):
        raise InputError(
            f"a Bézier curve of degree {degree} needs {2 * degree + 2} points, not {len(curve)}"
        )
    steps = np.linalg.norm(np.diff(curve, axis=0), axis=1)
    t = np.concatenate([[0.0], np.cumsum(steps)]) / steps.sum()
    bezier = _solve(curve, t, degree, slope)
    for _ in range(_ROUNDS):
        offset = curve - bezier.at(t)
        first, second = bezier.at(t, 1), bezier.at(t, 2)
        stiffness = (first**2).sum(1) - (offset * second).sum(1)
        move = (offset * first).sum(1) / np.maximum(stiffness, 0.5 * (first**2).sum(1))
        t = np.clip(t + move, 0.0, 1.0)
        bezier = _solve(curve, t, degree, slope)
    distance = np.sqrt(((curve - bezier.at(t)) ** 2).sum(1).mean())
    return bezier, float(distance)


def _solve(curve: np.ndarray, t: np.ndarray, degree: int, slope: float) -> Bezier:
    """Linear least squares for fixed parameters t (N,).

    Unknowns: the distance of the second control point from the first, which is 0, along the
    clamp's direction, and the other control points.
    """
    basis = bernstein(t, degree)
    n = len(t)
    direction = np.array([np.cos(slope), np.sin(slope)])
    matrix = np.zeros((2 * n, 1 + 2 * (degree - 1)))
    for k in range(2):
        rows = slice(k * n, (k + 1) * n)
        matrix[rows, 0] = direction[k] * basis[:, 1]
        matrix[rows, 1 + k :: 2] = basis[:, 2:]
    solution = np.linalg.lstsq(matrix, curve.T.ravel(), rcond=None)[0]
    return Bezier(np.vstack([[0.0, 0.0], solution[0] * direction, solution[1:].reshape(-1, 2)]))
