"""Map of a drape from all views of a capture, independent of the camera.

Seen from a point on the axis, below the plate, a drape is nearly star-shaped: it is described by
its distance as a function of azimuth and elevation, into which all views are fused.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.ndimage import gaussian_filter1d

from common.types import Radians, Turns
from drapenet.views.directions import AZIMUTH, AZIMUTHS, ELEVATIONS, Polar, elevations
from drapenet.views.located import LocatedViews
from sim.rig import Rig

PIXEL = 1.73e-3  # m, of the rig's camera on the plate, the unit of weights
_LENGTH_BIAS = (-0.02, 0.01)  # m, range of the bias of the length from rim to hem
_MAX_LENGTH_ERROR = 0.02  # m, at which the cost of a length error saturates
WEIGHT_UNIT = 1 / 32  # of the stored logarithm of 1 + weight
SIGMAS = (0.7, 1.5, 4.0, 12.0)  # cells, of the successive Gaussians that fill gaps


@dataclass(frozen=True)
class RadialMap:
    """Distance of a captured drape by direction from a point on its axis.

    Distances, m, with gaps filled, and weights are (AZIMUTHS, ELEVATIONS): azimuths run
    counter-clockwise from ``zero``, rows from the lowest up.
    """

    distance: np.ndarray
    weight: np.ndarray  # pixels of the reference camera, 0 in gaps
    zero: Radians  # direction of azimuth 0 in the first view
    views: int  # their number


def compressed(distance: np.ndarray, weight: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distances, in sizes (m/m), and logarithms of 1 + weight in their unit, of the same shape."""
    return (distance.astype(np.float16),
            np.minimum(np.rint(np.log1p(weight) / WEIGHT_UNIT), 255).astype(np.uint8))


def radial_map(
    located: LocatedViews, *, zero: Radians | None = None, near: Radians | None = None
) -> RadialMap:
    """Fuse the views of one capture; ``zero`` None: :func:`side_direction`, of a disc 0."""
    rig = located.rig
    camera = located.camera
    turns = located.turns
    seen = [Polar.of(cloud, located.centre, rig) for cloud in located.clouds]
    if zero is None:
        zero = 0.0 if rig.specimen == "disc" else side_direction(
            *fused(seen, turns), rig, near)
    distance, weight = fused(seen, turns + zero)
    pixel = np.linalg.norm(camera.world_to_camera[:3, 3]) / camera.fx
    return RadialMap(distance, weight * (pixel / PIXEL) ** 2, zero, len(located.views))


def side_direction(
    distance: np.ndarray, weight: np.ndarray, rig: Rig, near: Radians | None = None
) -> float:
    """Direction of a rectangle's first side, in [0, pi) rad from azimuth 0, or, as any of its sides
    may be the first, in [0, pi/2) of a square; ``near``: at most pi/4 from this or its opposite.

    The length of cloth from rim to hem is that of the flat specimen, longest towards the four
    corners; the direction minimises the error of these lengths. Shapes as in :class:`RadialMap`.
    """
    borders = elevations(rig)
    height = (borders[1:] + borders[:-1]) / 2
    radius = distance * np.cos(height)
    up = distance * np.sin(height)
    steps = np.hypot(np.diff(radius, axis=1), np.diff(up, axis=1))
    visible = weight > 0
    hem = np.where(visible.any(axis=1), visible.argmax(axis=1), ELEVATIONS)
    below = np.arange(ELEVATIONS) >= hem[:, None]
    lengths = (steps * below[:, :-1]).sum(axis=1)
    # Lengths are unreliable where little of a line is visible.
    trust = ((visible & below).sum(axis=1) / np.maximum(below.sum(axis=1), 1)) ** 2 + 1e-3
    turn = rig.symmetry
    sides = np.radians(np.arange(0.0, np.degrees(turn)))
    if near is not None:  # a rectangle that is nearly square looks much the same across
        sides = sides[np.abs((sides - near + turn / 2) % turn - turn / 2) < np.pi / 4 + 1e-9]
    direction = AZIMUTH - sides[:, None]
    gap = lengths - (rig.border(direction) - rig.plate_radius)
    # Correct the common bias of the hem; the cost saturates for outliers of single folds.
    gap -= np.clip(np.median(gap, axis=1, keepdims=True), *_LENGTH_BIAS)
    return float(sides[(trust * np.minimum(np.abs(gap), _MAX_LENGTH_ERROR)).sum(axis=1).argmin()])


def fused(seen: list[Polar], turns: Turns) -> tuple[np.ndarray, np.ndarray]:
    """Distances, gaps filled, and weights of a map (AZIMUTHS, ELEVATIONS) from all views' points.
    """
    total, weight = np.zeros((2, AZIMUTHS, ELEVATIONS))
    for view, turn in zip(seen, turns, strict=True):
        sums, part = view.binned(turn, AZIMUTHS, ELEVATIONS)
        total += sums
        weight += part
    mean, visible = total / np.maximum(weight, 1e-12), weight > 0
    return np.where(visible, mean, smoothed_map(mean, visible, SIGMAS, least=0.05)), weight


def smoothed_map(
    mean: np.ndarray, visible: np.ndarray, sigmas: Sequence[float], *, least: float
) -> np.ndarray:
    """A map (azimuths, elevations) smoothed by the narrowest of the Gaussians under which a cell
    has a weight of at least ``least``; 0 if nothing is ``visible``.
    """
    result = np.full(mean.shape, mean[visible].mean() if visible.any() else 0.0)
    for sigma in reversed(sigmas):
        around, along = (_gaussian(size, sigma, mode)
                         for size, mode in zip(mean.shape, ("wrap", "nearest"), strict=True))
        weight, total = (around @ part @ along.T
                         for part in (visible.astype(float), np.where(visible, mean, 0.0)))
        enough = weight > least
        result[enough] = total[enough] / weight[enough]
    return result


@lru_cache(maxsize=64)
def _gaussian(size: int, sigma: float, mode: str) -> np.ndarray:
    """Matrix (size, size) of SciPy's Gaussian filter along an axis; of wide ones, a tenth of the
    filter's time."""
    return gaussian_filter1d(np.eye(size), sigma, axis=0, mode=mode)
