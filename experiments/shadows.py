"""Outlines of drapes as seen from above: drapes to compare with, radii, and their features."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Circle

from common.types import Metres, Outline
from data.fabrics.fabrics import fabric_from_theta
from experiments.drapes import plan_specimen
from sim.draping import Drape, drape
from sim.material import MICRO, Fabric
from sim.measures import shadow_radius
from sim.mesh import Mesh
from sim.outlines import coefficient_of_area, folds_around
from sim.rig import DISC_RIG, Rig

POINTS = 360  # azimuths of an outline
SIGMA = 2.0  # of the smoothing before folds are counted, azimuths
HARMONICS = np.arange(2, 17)


def isotropic_fabric(alpha: float, ratio_mm: float) -> Fabric:
    """The fabric of the same linear modulus ``alpha``, µN·m, in all directions, and of
    ``ratio_mm``, beta over alpha."""
    alphas = np.full(3, alpha * MICRO)
    return Fabric(alphas, 1e-3 * ratio_mm * alphas)


def specimen(
    alpha: float, fabric: Fabric | None, seed: int, edge: Metres, rig: Rig = DISC_RIG, *,
    words: Sequence[str] = ()
) -> Drape:
    """A lowered drape, off-centre and with the nuisances of datasets, of a specimen of ``fabric``;
    None: of one of the prior, drawn with the overrides ``words`` of a dataset's config and scaled
    to the geometric mean ``alpha``, µN·m."""
    plan = plan_specimen(seed, *words, seed=0, nuisances="real", rig=rig)
    theta = plan.theta.copy()
    theta[:3] += np.log(alpha * MICRO) - theta[:3].mean()
    return drape(fabric or fabric_from_theta(theta), rig=plan.nuisances.rig(rig), edge=edge,
                 seed=seed, offset=tuple(plan.offset), laws=plan.nuisances.laws)


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
