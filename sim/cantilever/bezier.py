"""Smoothing of deflection curves by Bézier curves (Feng et al. 2022, section 4.3)."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.integrate import cumulative_trapezoid
from scipy.special import comb

from common.errors import InputError

DEGREES = range(3, 15)
"""Candidate degrees of a Bézier curve. A cubic curve (section 4.3) cannot follow the curvature from
clamp to free end: its error of alpha is at least 6 % (docs/validation.md)."""

_PROJECTIONS = 30  # updates of the points' parameters


@dataclass(frozen=True)
class Bezier:
    """A plane Bézier curve with control points (d + 1, 2), m."""

    control: np.ndarray

    def at(self, t: np.ndarray, order: int = 0) -> np.ndarray:
        """Points (N, 2), or derivatives of that ``order``, at parameters t (N,) in [0, 1]."""
        points = self.control
        for _ in range(order):
            points = (len(points) - 1) * np.diff(points, axis=0)
        return bernstein(t, len(points) - 1) @ points

    @cached_property
    def _lengths(self) -> tuple[np.ndarray, np.ndarray]:
        t = np.linspace(0.0, 1.0, 2049)
        return t, cumulative_trapezoid(np.linalg.norm(self.at(t, 1), axis=1), t, initial=0)

    @property
    def length(self) -> float:
        """Arc length, m."""
        return float(self._lengths[1][-1])

    def sample(self, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Points (count, 2), m, equidistant in arc length, ends included, and their curvatures
        (count,), 1/m, positive where the strip bends down."""
        t, s = self._lengths
        t = np.interp(np.linspace(0.0, s[-1], count), s, t)
        (x, y), (xx, yy) = self.at(t, 1).T, self.at(t, 2).T
        return self.at(t), (x * yy - y * xx) / np.hypot(x, y) ** 3


def bernstein(t: np.ndarray, degree: int) -> np.ndarray:
    """(N, degree + 1) Bernstein polynomials at t (N,)."""
    k, t = np.arange(degree + 1), t[:, None]
    return comb(degree, k) * t**k * (1.0 - t) ** (degree - k)


def arc_lengths(points: np.ndarray) -> np.ndarray:
    """Arc lengths (N,), m, along the polygon of points (N, 2) from the first one."""
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    return np.concatenate([[0.0], np.cumsum(steps)])


def fit_bezier(curve: np.ndarray, *, degree: int = 0, slope: float = 0.0) -> tuple[Bezier, float]:
    """Least-squares Bézier curve of points (N, 2), m, starting at 0 in the clamp's direction.

    Each point's parameter is moved to the nearest point of the fitted curve, and the fit is
    repeated. ``degree`` 0 selects the degree in :data:`DEGREES` with the smallest Bayesian
    information criterion, so that noise is not fitted. InputError for a degree below 2, or too few
    points for the degree.

    Returns:
        The curve and the root mean square distance of the points from it, m.
    """
    count = len(curve)
    degrees = [degree] if degree else [d for d in DEGREES if 2 * (d + 1) <= count] or DEGREES[:1]
    if degrees[0] < 2:
        raise InputError(f"a Bézier curve of degree {degree} cannot bend; give 2 or more")
    if count < (needed := 2 * (degrees[0] + 1)):
        raise InputError(f"a Bézier curve of degree {degrees[0]} needs {needed} points, "
                         f"not {count}")
    # Distances below 1e-6 of the curve's size are not distinguished. Each point contributes one
    # residual, its distance across the curve.
    least = (1e-6 * np.linalg.norm(curve[-1])) ** 2
    return min((_fit_degree(curve, each, slope) for each in degrees), key=lambda fit: (
        count * np.log(fit[1] ** 2 + least) + 2 * len(fit[0].control) * np.log(count)))


def _fit_degree(curve: np.ndarray, degree: int, slope: float) -> tuple[Bezier, float]:
    t = arc_lengths(curve)
    t /= t[-1]
    bezier = _solve(curve, t, degree, slope)
    for _ in range(_PROJECTIONS):
        offset = curve - bezier.at(t)
        first, second = bezier.at(t, 1), bezier.at(t, 2)
        speed = (first**2).sum(1)
        stiffness = np.maximum(speed - (offset * second).sum(1), 0.5 * speed)
        t = np.clip(t + (offset * first).sum(1) / stiffness, 0.0, 1.0)
        bezier = _solve(curve, t, degree, slope)
    return bezier, float(np.sqrt(((curve - bezier.at(t)) ** 2).sum(1).mean()))


def _solve(curve: np.ndarray, t: np.ndarray, degree: int, slope: float) -> Bezier:
    """Linear least squares for fixed parameters t (N,). The first control point is 0; unknowns are
    the distance of the second along the clamp's direction and the other control points."""
    basis = bernstein(t, degree)
    along = np.array([np.cos(slope), np.sin(slope)])
    matrix = np.hstack([np.kron(basis[:, 1:2], along[:, None]), np.kron(basis[:, 2:], np.eye(2))])
    second, *others = np.linalg.lstsq(matrix, curve.ravel(), rcond=None)[0]
    return Bezier(np.vstack([[0.0, 0.0], second * along, np.reshape(others, (-1, 2))]))
