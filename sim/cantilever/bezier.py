"""Deflection curves smoothed by Bézier curves (Feng et al. 2022, section 4.3)."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.integrate import cumulative_trapezoid
from scipy.special import comb

from common.errors import InputError

DEGREES = range(3, 15)
"""Degrees tried for a Bézier curve. A cubic one (section 4.3) cannot follow the curvature from the
clamp to the free end: it misreads alpha by 6 % at best (docs/validation.md)."""

_ROUNDS = 30


@dataclass(frozen=True)
class Bezier:
    """A plane Bézier curve with control points (d + 1, 2), m."""

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
        return t, cumulative_trapezoid(np.linalg.norm(self.at(t, 1), axis=1), t, initial=0)

    @property
    def length(self) -> float:
        """Arc length, m."""
        return float(self._lengths[1][-1])

    def sample(self, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Points (count, 2), m, at equal arc lengths, ends included, and curvatures (count,), 1/m,
        there, positive where the strip bends down."""
        t, s = self._lengths
        t = np.interp(np.linspace(0.0, s[-1], count), s, t)
        (x, y), (xx, yy) = self.at(t, 1).T, self.at(t, 2).T
        return self.at(t), (x * yy - y * xx) / np.hypot(x, y) ** 3


def bernstein(t: np.ndarray, degree: int) -> np.ndarray:
    """(N, degree + 1) Bernstein polynomials at t (N,)."""
    k, t = np.arange(degree + 1), t[:, None]
    return comb(degree, k) * t**k * (1.0 - t) ** (degree - k)


def arc_lengths(points: np.ndarray) -> np.ndarray:
    """(N,) lengths, m, of the polygon of points (N, 2) from the first up to each."""
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    return np.concatenate([[0.0], np.cumsum(steps)])


def fit_bezier(curve: np.ndarray, *, degree: int = 0, slope: float = 0.0) -> tuple[Bezier, float]:
    """Least-squares Bézier curve of points (N, 2), m, that leaves the clamp's edge, 0, along it.

    Each point's parameter is moved to the nearest point of the fitted curve, and the fit
    repeated. ``degree`` 0 stands for the one in :data:`DEGREES` with the least Bayesian
    information criterion, so that noise is not fitted. InputError for a degree below 2, or fewer
    points than it needs.

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
    # Distances below 1e-6 of the curve's size are not distinguished. What counts is a point's
    # distance across the curve: one number a point.
    least = (1e-6 * np.linalg.norm(curve[-1])) ** 2
    return min((_fit_degree(curve, each, slope) for each in degrees), key=lambda fit: (
        count * np.log(fit[1] ** 2 + least) + 2 * len(fit[0].control) * np.log(count)))


def _fit_degree(curve: np.ndarray, degree: int, slope: float) -> tuple[Bezier, float]:
    t = arc_lengths(curve)
    t /= t[-1]
    bezier = _solve(curve, t, degree, slope)
    for _ in range(_ROUNDS):
        offset = curve - bezier.at(t)
        first, second = bezier.at(t, 1), bezier.at(t, 2)
        speed = (first**2).sum(1)
        stiffness = np.maximum(speed - (offset * second).sum(1), 0.5 * speed)
        t = np.clip(t + (offset * first).sum(1) / stiffness, 0.0, 1.0)
        bezier = _solve(curve, t, degree, slope)
    return bezier, float(np.sqrt(((curve - bezier.at(t)) ** 2).sum(1).mean()))


def _solve(curve: np.ndarray, t: np.ndarray, degree: int, slope: float) -> Bezier:
    """Linear least squares for fixed parameters t (N,): the distance of the second control point
    from the first, which is 0, along the clamp's direction, and the other control points."""
    basis = bernstein(t, degree)
    along = np.array([np.cos(slope), np.sin(slope)])
    matrix = np.hstack([np.kron(basis[:, 1:2], along[:, None]), np.kron(basis[:, 2:], np.eye(2))])
    second, *others = np.linalg.lstsq(matrix, curve.ravel(), rcond=None)[0]
    return Bezier(np.vstack([[0.0, 0.0], second * along, np.reshape(others, (-1, 2))]))
