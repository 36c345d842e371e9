"""Outlines of drapes as seen from above: radii, their features, and fabrics that have them."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Circle
from scipy.interpolate import RegularGridInterpolator
from scipy.optimize import least_squares

from common.types import Metres, Outline
from sim.drape import Drape
from sim.material import MICRO, Fabric
from sim.measures import coefficient_of_area, folds_around, shadow_radius
from sim.mesh import Mesh
from sim.rig import DISC_RIG, Rig

POINTS = 360  # azimuths of an outline
SIGMA = 2.0  # of the smoothing before folds are counted, azimuths
HARMONICS = np.arange(2, 17)
MAX_MISFIT = 1e-3  # of the drape coefficient, beyond which no fabric of the grid has it


def isotropic_fabric(alpha: float, ratio_mm: float) -> Fabric:
    """The fabric of the same linear modulus ``alpha``, µN·m, in all directions, and of
    ``ratio_mm``, beta over alpha."""
    alphas = np.full(3, alpha * MICRO)
    return Fabric(alphas, 1e-3 * ratio_mm * alphas)


def shadows(shapes: Sequence[Drape], heights: Mapping[str, Metres]) -> dict[str, Any]:
    """Result of a case: radii (N, POINTS), m, of the converged ones of ``shapes`` as seen by
    cameras at the named ``heights`` above the plate, and how many ``failed``."""
    done = [shape for shape in shapes if shape.converged]
    radii = {name: [shadow_radius(shape.positions, Mesh(shape.rest, shape.faces), height=height,
                                  points=POINTS) for shape in done]
             for name, height in heights.items()}
    return {"failed": len(shapes) - len(done),
            "arrays": {name: np.reshape(each, (-1, POINTS)) for name, each in radii.items()}}


def features(
    radii: np.ndarray, rig: Rig = DISC_RIG, harmonics: np.ndarray = HARMONICS
) -> np.ndarray:
    """(N, 3 + H) drape coefficient, folds, standard deviation (mm), and amplitudes (mm) of the
    ``harmonics`` (H,), of outlines (N, POINTS) m."""
    coefficient = coefficient_of_area(np.pi * (radii**2).mean(axis=1), rig)
    folds = [len(folds_around(radius, SIGMA)) for radius in radii]
    amplitudes = 2 * np.abs(np.fft.rfft(radii, axis=1))[:, harmonics] / POINTS
    return np.column_stack([coefficient, folds, 1e3 * radii.std(axis=1), 1e3 * amplitudes])


def radii_of(curve: Outline) -> np.ndarray:
    """Radii (POINTS,), m, of an outline at equally spaced azimuths."""
    azimuth = np.arctan2(curve[:, 1], curve[:, 0])
    order = azimuth.argsort()
    return np.interp(2 * np.pi * np.arange(POINTS) / POINTS, azimuth[order],
                     np.linalg.norm(curve, axis=1)[order], period=2 * np.pi)


def about_centroid(radii: np.ndarray) -> np.ndarray:
    """Radii (POINTS,), m, of an outline of ``radii`` (POINTS,) about the centroid of its area."""
    azimuths = 2 * np.pi * np.arange(POINTS) / POINTS
    around = np.column_stack([np.cos(azimuths), np.sin(azimuths)])
    centroid = radii**3 @ around / (1.5 * (radii**2).sum())
    return radii_of(radii[:, None] * around - centroid)


class Simulated:
    """Mean features of simulated drapes as a function of log alpha and natural curvature."""

    def __init__(self, alphas: Sequence[float], curls: Sequence[float], means: np.ndarray) -> None:
        self._axes = np.log(alphas), np.asarray(curls, dtype=np.float64)
        self._means = RegularGridInterpolator(self._axes, means)

    def at(self, log_alpha: float, curl: float) -> np.ndarray:
        """Features (3 + H,) of a fabric of ``log_alpha``, µN·m, and natural curvature, 1/m, both
        inside the grid."""
        return self._means([log_alpha, curl])[0]

    def fitted(self, coefficients: Sequence[float], *, curled: bool) -> tuple[float, float] | None:
        """Log alpha and natural curvature, 1/m, at the drape coefficients of the face up and the
        other face; without ``curled``: at a single one, and no natural curvature. None if no fabric
        inside the grid has them."""
        alphas, curls = self._axes
        reach = min(-curls[0], curls[-1])
        low, high = [alphas[0], -1.0], [alphas[-1], 1.0]  # of log alpha and curl over its reach
        unknowns = slice(2 if curled else 1)

        def curl(x: np.ndarray) -> float:
            return reach * x[1] if curled else 0.0

        def misfit(x: np.ndarray) -> np.ndarray:
            return np.array([self.at(x[0], sign * curl(x))[0] - coefficient
                             for sign, coefficient in zip((1, -1), coefficients, strict=False)])

        start = np.array([alphas.mean(), 0.0])[unknowns]
        fit = least_squares(misfit, start, bounds=(low[unknowns], high[unknowns]), diff_step=1e-2)
        if np.abs(fit.fun).max() > MAX_MISFIT:
            return None
        return float(fit.x[0]), float(curl(fit.x))


def draw_outline(
    axes: Axes, radius: np.ndarray, name: str, color: str, rig: Rig = DISC_RIG
) -> None:
    """An outline (POINTS,), m, its drape coefficient, its folds and the plate."""
    azimuths = 2 * np.pi * np.arange(POINTS) / POINTS
    coefficient, folds = features(radius[None], rig)[0, :2]
    axes.fill(radius * np.cos(azimuths), radius * np.sin(azimuths), color=color)
    axes.add_patch(Circle((0, 0), rig.plate_radius, fill=False, color="white", lw=0.8))
    reach = (-rig.reach, rig.reach)
    axes.set(xlim=reach, ylim=reach, xticks=[], yticks=[], aspect="equal")
    axes.set_title(f"{name}\n{100 * coefficient:.0f} %, {folds:.0f} folds", fontsize=7)
