"""Deflection curves smoothed by Bézier curves (Feng et al. 2022, section 4.3)."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.special import comb

from common.errors import InputError

DEGREES = range(3, 15)
"""Degrees tried for a Bézier curve. A cubic one (section 4.3) cannot follow the curvature from the
clamp to the free end: it misreads alpha by 6 % at best (docs/validation.md)."""

_ROUNDS = 30


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
    k, t = np.arange(degree + 1), t[:, None]
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
    count = len(curve)  # what counts is a point's distance across the curve
    # Distances below 1e-6 of the curve's size are not distinguished.
    least = (1e-6 * np.linalg.norm(curve[-1])) ** 2
    fits = [_fit_degree(curve, each, slope) for each in DEGREES if 2 * (each + 1) <= count]
    if not fits:
        raise InputError(f"{count} points are too few for a Bézier curve")
    return min(fits, key=lambda fit: count * np.log(fit[1] ** 2 + least)
               + 2 * len(fit[0].control) * np.log(count))


def _fit_degree(curve: np.ndarray, degree: int, slope: float) -> tuple[Bezier, float]:
    needed = 2 * (degree + 1)
    if degree < 2:
        raise InputError(f"a Bézier curve of degree {degree} cannot bend; give 2 or more")
    if needed > len(curve):
        raise InputError(
            f"a Bézier curve of degree {degree} needs {needed} points, not {len(curve)}"
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
    direction = np.array([np.cos(slope), np.sin(slope)])
    matrix = np.hstack([
        np.kron(basis[:, 1:2], direction[:, None]), np.kron(basis[:, 2:], np.eye(2))
    ])
    solution = np.linalg.lstsq(matrix, curve.ravel(), rcond=None)[0]
    return Bezier(np.vstack([[0.0, 0.0], solution[0] * direction, solution[1:].reshape(-1, 2)]))
