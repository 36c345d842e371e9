"""Simulates drapes of an estimate; the one that fits the captured silhouettes best is shown.

A fabric has many drapes, and which of them a specimen takes is random. The mirror image of a drape
is an equally likely drape of the same fabric, at no cost.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from common.types import Faces, Metres, Points, Radians, Turns, Views
from data.render.cameras import Camera
from data.render.raster import rasterise
from drapenet.views.located import LocatedViews
from sim.cloth import Laws
from sim.drape import Drape, drape
from sim.material import Fabric
from sim.measures import drape_coefficient, folds_around

TURNS = 48  # orientations tried in the fit
FIT_WIDTH = 120  # pixels, width of the images compared in it
PROFILE_HEIGHT, PROFILE_BAND = -0.04, 0.016  # m above the plate, of radius profiles, and around it
BINS = 180  # of a radius profile
MIN_OVERLAP = 0.7
"""Of the silhouettes. Correct captures have at least 0.82 (0.74 on a coarse mesh), those with
a focal length a fifth too short or too long 0.6 to 0.7, views upside down 0.45."""
STARTS = (("sine", 0), ("sine", 1), ("fold", 0), ("fold", 1))


@dataclass(frozen=True)
class Resimulation:
    """A simulated drape of the estimate beside the captured one.

    Attributes:
        views: of the simulated drape.
        drape: possibly before reflection.
        positions: of its vertices, in the orientation of the first view.
        statuses: of all simulated drapes, in the order of :data:`STARTS`.
    """

    located: LocatedViews
    views: Views
    drape: Drape
    positions: Points
    statuses: tuple[str, ...]

    @cached_property
    def profiles(self) -> tuple[np.ndarray, np.ndarray]:
        """Radius profiles (BINS,), m, captured and simulated."""
        located = self.located
        return (radius_profile(located.views, located.camera, located.turns),
                radius_profile(self.views, located.camera, located.turns))

    @property
    def folds(self) -> tuple[int, int]:
        """Number of folds, captured and simulated."""
        return count_folds(self.profiles[0]), count_folds(self.profiles[1])

    @cached_property
    def overlap(self) -> float:
        """Mean intersection over union of the silhouettes."""
        return silhouette_overlap(self.located.views, self.views)

    @property
    def warnings(self) -> list[str]:
        """One line if the silhouettes overlap too little."""
        if self.overlap >= MIN_OVERLAP:
            return []
        return [f"the simulated drape has only {self.overlap:.0%} of its silhouette in common with "
                "the captured one: check the pictures, their intrinsics and the tester; if they "
                "are right, the fabric is unlike those trained on"]

    def as_dict(self) -> dict:
        """Drape coefficient, folds, overlap and statuses in JSON's types."""
        coefficient = drape_coefficient(self.drape.positions, self.drape.faces, self.drape.rig)
        return {"drape_coefficient_percent": round(100 * coefficient, 1),
                "folds_captured": self.folds[0], "folds_simulated": self.folds[1],
                "silhouette_overlap": self.overlap, "statuses": list(self.statuses)}


def resimulate(
    fabric: Fabric, located: LocatedViews, *, edge: Metres, drapes: int, laws: Laws | None = None
) -> Resimulation | None:
    """Simulate up to four drapes of ``fabric`` and fit them to captured views; None if none
    converges. ``laws`` are those of cloth of 300 g/m².
    """
    views, camera, turns = located.views, located.camera, located.turns
    step = max(1, round(camera.width / FIT_WIDTH))
    captured = views[:, ::step, ::step] > 0
    small = camera.resized(captured.shape[2], captured.shape[1])
    best, statuses = None, []
    for start, seed in STARTS[:drapes]:
        result = drape(fabric, rig=located.rig, edge=edge, start=start, seed=seed, laws=laws)
        statuses.append(result.status.value)
        if not result.converged:
            continue
        for side in (1, -1):
            positions = result.positions * [side, 1, 1]
            overlap, orientation = _fit_orientation(positions, result.faces, small, captured, turns)
            if best is None or overlap > best[0]:
                best = overlap, positions, orientation, result
    if best is None:
        return None
    _, positions, orientation, result = best
    shown = rasterise(positions, result.faces, camera, orientation + turns)
    return Resimulation(located, shown, result, turned(positions, orientation), tuple(statuses))


def turned(points: Points, angle: Radians) -> Points:
    """Points turned about the table's axis, counter-clockwise."""
    cos, sin = math.cos(angle), math.sin(angle)
    return points @ np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])


def radius_profile(views: Views, camera: Camera, turns: Turns) -> np.ndarray:
    """Distance (BINS,), m, of the cloth from the axis by azimuth, at :data:`PROFILE_HEIGHT`.

    Cloth that faces the camera has the largest weight. NaN where no view shows cloth.
    """
    total, weight = np.zeros((2, BINS))
    for turn, view in zip(turns, views, strict=True):
        points = camera.cloth_points(view)
        band = points[np.abs(points[:, 2] - PROFILE_HEIGHT) < PROFILE_BAND / 2]
        azimuth = np.arctan2(band[:, 1], band[:, 0])
        facing = np.maximum(-np.sin(azimuth), 0) ** 4  # the camera is at -y
        bin_of = np.floor((azimuth - turn) / (2 * np.pi) * BINS).astype(int) % BINS
        np.add.at(total, bin_of, facing * np.hypot(band[:, 0], band[:, 1]))
        np.add.at(weight, bin_of, facing)
    return np.where(weight > 1e-3, total / np.maximum(weight, 1e-3), np.nan)


def count_folds(profile: np.ndarray) -> int:
    """Number of outward folds of a radius profile (bins,), which may have gaps."""
    bins = np.flatnonzero(np.isfinite(profile))
    if len(bins) < len(profile) // 2:
        return 0
    filled = np.interp(np.arange(len(profile)), bins, profile[bins], period=len(profile))
    return len(folds_around(filled, len(profile) / 90))


def silhouette_overlap(first: Views, second: Views) -> float:
    """Mean intersection over union of the cloth in two sets of views."""
    a, b = first > 0, second > 0
    union = (a | b).sum(axis=(1, 2))
    return float(np.mean((a & b).sum(axis=(1, 2)) / np.maximum(union, 1)))


def _fit_orientation(
    positions: Points, faces: Faces, camera: Camera, captured: np.ndarray, turns: Turns
) -> tuple[float, Radians]:
    """Largest overlap with silhouettes (K, H, W) and the orientation that gives it."""
    step = 2 * math.pi / TURNS
    # All views are rotations by whole steps, so each is rendered once.
    views = rasterise(positions, faces, camera, np.arange(TURNS) * step)
    after = np.rint(turns / step).astype(int)
    overlaps = [silhouette_overlap(captured, views[(turn + after) % TURNS])
                for turn in range(TURNS)]
    turn = int(np.argmax(overlaps))
    return overlaps[turn], turn * step
