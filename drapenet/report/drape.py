"""Simulates drapes of an estimate; the one that fits the captured silhouettes best is shown.

A fabric has many drapes, and which of them a specimen takes is random. The mirror image of a drape
is an equally likely drape of the same fabric, at no cost.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from common.compiled import announce
from common.findings import Finding
from common.types import Faces, Masks, Metres, Points, Radians, Turns, Views
from data.render.cameras import Camera
from data.render.raster import rasterise
from drapenet.views.directions import AZIMUTHS
from drapenet.views.located import LocatedViews
from drapenet.views.outline import DrapeOutline, count_folds, silhouettes
from sim.cloth import Laws
from sim.draping import Drape, drape
from sim.material import Fabric
from sim.measures import drape_coefficient
from sim.mesh import Mesh
from sim.nearest import nearest
from sim.rig import Rig
from sim.start import LOWERED

TURNS = 48  # orientations tried in the fit
FIT_WIDTH = 120  # pixels, width of the images compared in it
PROFILE_HEIGHT, PROFILE_BAND = -0.04, 0.016  # m above the plate, of radius profiles, and around it
BINS = 180  # of a radius profile
MIN_OVERLAP = 0.7
"""Of the silhouettes, or of the outlines. Of 42 sound captures on three testers two have less, both
outlines of limp squares (``experiments misses``); captures with a focal length a fifth too short or
too long have 0.6 to 0.7, views upside down 0.45."""
MAX_COEFFICIENT_GAP = 0.15
"""Largest difference of the captured and the simulated drape coefficient, from 0 to 1, without a
warning: of 42 sound captures on three testers one differs by more (``experiments misses``)."""


@dataclass(frozen=True)
class Resimulation:
    """A simulated drape of the estimate beside the captured one.

    Attributes:
        views: of the simulated drape; of a photograph's, none.
        drape: possibly before reflection.
        positions: of its vertices, in the orientation of the first view or the photograph.
        statuses: of all simulated drapes.
        profiles: radii (bins,), m, by azimuth, captured and simulated.
        overlap: intersection over union of the silhouettes, or of the outlines.
    """

    views: Views
    drape: Drape
    positions: Points
    statuses: tuple[str, ...]
    profiles: tuple[np.ndarray, np.ndarray]
    overlap: float

    @classmethod
    def beside(
        cls, located: LocatedViews, views: Views, drape: Drape, positions: Points,
        statuses: tuple[str, ...],
    ) -> "Resimulation":
        """Beside captured views."""
        seen, simulated = (radius_profile(part, located.camera, located.turns)
                           for part in (located.views, views))
        return cls(views, drape, positions, statuses, (seen, simulated),
                   silhouette_overlap(located.views, views))

    @classmethod
    def beside_outline(
        cls, outline: DrapeOutline, drape: Drape, positions: Points, statuses: tuple[str, ...],
    ) -> "Resimulation":
        """Beside an outline seen from above."""
        shown = _radii(positions, drape.faces, outline.height)
        overlap = float(np.nansum(np.square(np.fmin(outline.radius, shown)))
                        / np.nansum(np.square(np.fmax(outline.radius, shown))))
        return cls(np.zeros((0, 1, 1), np.float32), drape, positions, statuses,
                   (outline.radius, shown), overlap)

    @property
    def folds(self) -> tuple[int | None, int | None]:
        """Number of folds, captured and simulated."""
        return count_folds(self.profiles[0]), count_folds(self.profiles[1])

    @cached_property
    def coefficient(self) -> float:
        """Drape coefficient of the simulated drape, from 0 to 1."""
        return drape_coefficient(self.drape.positions, self.drape.faces, self.drape.rig)

    def warnings(self, captured: float) -> list[Finding]:
        """One if the silhouettes overlap too little, and one if the simulated drape
        coefficient is far from the ``captured`` one, from 0 to 1, NaN: unknown."""
        found = []
        if self.overlap < MIN_OVERLAP:
            found.append(Finding("silhouette_differs", {"value": float(self.overlap),
                                                        "limit": MIN_OVERLAP}))
        if abs(self.coefficient - captured) > MAX_COEFFICIENT_GAP:
            found.append(Finding("coefficient_differs", {
                "value": 100 * float(self.coefficient), "expected": 100 * float(captured),
                "limit": 100 * MAX_COEFFICIENT_GAP}))
        return found

    def as_dict(self) -> dict:
        """Drape coefficient, folds, overlap and statuses in JSON's types."""
        return {"drape_coefficient_percent": round(100 * self.coefficient, 1),
                "folds_captured": self.folds[0], "folds_simulated": self.folds[1],
                "silhouette_overlap": self.overlap, "statuses": list(self.statuses)}


def resimulate(
    fabric: Fabric, located: LocatedViews, *, edge: Metres, drapes: int, laws: Laws | None = None
) -> Resimulation | None:
    """Simulate lowered drapes of ``fabric`` and fit them to captured views; None if none
    converges. ``laws`` are those of cloth of 300 g/m².
    """
    views, camera, turns = located.views, located.camera, located.turns
    step = max(1, round(camera.width / FIT_WIDTH))
    captured = views[:, ::step, ::step] > 0
    small = camera.resized(captured.shape[2], captured.shape[1])

    def fit(positions: Points, faces: Faces) -> tuple[float, Radians]:
        return _fit_orientation(positions, faces, small, captured, turns)

    best = _nearest(fabric, located.rig, fit, edge=edge, drapes=drapes, laws=laws)
    if best is None:
        return None
    result, positions, orientation, statuses = best
    shown = rasterise(positions, result.faces, camera, orientation + turns)
    return Resimulation.beside(located, shown, result, turned(positions, orientation), statuses)


def resimulate_outline(
    fabric: Fabric, outline: DrapeOutline, rig: Rig, *, edge: Metres, drapes: int,
    laws: Laws | None = None,
) -> Resimulation | None:
    """As :func:`resimulate`, fitted to an outline seen from above, from its camera's height, or as
    under parallel light if that is unknown."""
    rolls = np.array([np.roll(outline.radius, -k) for k in range(AZIMUTHS)])

    def fit(positions: Points, faces: Faces) -> tuple[float, Radians]:
        own = _radii(positions, faces, outline.height)
        overlaps = (np.square(np.minimum(rolls, own)).sum(axis=1)
                    / np.square(np.maximum(rolls, own)).sum(axis=1))
        return float(overlaps.max()), int(overlaps.argmax()) * 2 * np.pi / AZIMUTHS

    best = _nearest(fabric, rig, fit, edge=edge, drapes=drapes, laws=laws)
    if best is None:
        return None
    result, positions, orientation, statuses = best
    return Resimulation.beside_outline(outline, result, turned(positions, orientation), statuses)


def _radii(positions: Points, faces: Faces, height: Metres) -> np.ndarray:
    """(AZIMUTHS,) m, as seen from a ``height``, or as under parallel light if that is unknown."""
    edges = Mesh(positions[:, :2], faces).edges
    height = height if np.isfinite(height) else np.inf
    return silhouettes(positions, edges, np.array([height]), zero=0.0)[0]


def _nearest(
    fabric: Fabric, rig: Rig, fit: Callable[[Points, Faces], tuple[float, Radians]], *,
    edge: Metres, drapes: int, laws: Laws | None,
) -> tuple[Drape, Points, Radians, tuple[str, ...]] | None:
    """The simulated drape with the largest overlap by ``fit``, itself or as mirror image, its
    vertices, its orientation, and the statuses of all; None if none converges."""
    announce(nearest)
    # Lowered, as the specimens that the network learns from and as those of a laboratory.
    results = [drape(fabric, rig=rig, edge=edge, start=LOWERED, seed=seed, laws=laws)
               for seed in range(drapes)]
    found = [(*fit(result.positions * [side, 1, 1], result.faces), side, result)
             for result in results if result.converged for side in (1, -1)]
    if not found:
        return None
    _, orientation, side, result = max(found, key=lambda item: item[0])
    return (result, result.positions * [side, 1, 1], orientation,
            tuple(each.searched.status.value for each in results))


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


def silhouette_overlap(first: Views | Masks, second: Views | Masks) -> float:
    """Mean intersection over union of the cloth in two sets of views or of their masks."""
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
