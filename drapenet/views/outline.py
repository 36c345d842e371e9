"""Outline of a drape seen from above: radius over azimuth, from a photograph or from its shape.

Seen by a camera above the plate's axis, a hem below the plate looks smaller: a point at radius r
and depth d below the plate appears on the plate's plane at r H/(H + d), H the camera's height above
the plate; H is infinite under the parallel light of a drapemeter.
"""

import warnings
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from common.types import Edges, Metres, Outline, Points, Radians
from drapenet.views.directions import AZIMUTH, AZIMUTHS, elevations
from drapenet.views.radial_map import PIXEL, RadialMap
from sim.mesh import Mesh
from sim.outlines import closed, farthest, folds_around, hem_depth
from sim.rig import Rig

PERSPECTIVES = (0.0, 0.2, 0.4, 0.6, 0.8)
"""Sizes of the specimen over the camera's height at which outlines of drapes are stored; between
them radii are interpolated linearly, to 0.1 mm."""
_FINE = 8  # azimuths for each of the stored ones, at which a shape's silhouette is sampled

Radii = Annotated[np.ndarray, "(AZIMUTHS,) m, on the plate's plane; NaN where the hem is not seen"]


@dataclass(frozen=True)
class DrapeOutline:
    """The outline of one drape.

    Azimuths run counter-clockwise seen from above, from the warp if its direction is stated.
    """

    radius: Radii
    height: Metres = np.inf  # of the camera above the plate; NaN: unknown
    error: Radii | None = None  # standard deviation of each radius; None: exact

    def coefficient(self, rig: Rig) -> float:
        """Drape coefficient, from 0 to 1, of the picture: not corrected for perspective; NaN if
        less than half of the outline is seen."""
        size = rig.specimen_size
        return float(drape_coefficients(self.radius[None] / (size / 2), rig.plate_diameter / size,
                                        rig.specimen == "disc")[0])

    def corrected(self, rig: Rig) -> "DrapeOutline":
        """The outline under parallel light; the same if the camera's height is not known.

        Cloth does not stretch, so that the hem hangs the deeper, the nearer it is to the plate.
        """
        if not np.isfinite(self.height):
            return self
        flat, radius = rig.border(AZIMUTH), self.radius
        for _ in range(30):  # damped, as the depth changes fast near the flat specimen's border
            depth = hem_depth(radius, flat, rig)
            radius = (radius + self.radius * (1 + depth / self.height)) / 2
        return DrapeOutline(np.minimum(radius, np.maximum(flat, self.radius)))

    @property
    def folds(self) -> int | None:
        """Number of folds; None if less than half of the outline is seen."""
        return count_folds(self.radius)


def count_folds(profile: np.ndarray) -> int | None:
    """Number of outward folds of distances from the axis, (bins,) m; None if half are gaps."""
    bins = np.flatnonzero(np.isfinite(profile))
    if len(bins) < len(profile) // 2:
        return None
    filled = np.interp(np.arange(len(profile)), bins, profile[bins], period=len(profile))
    return len(folds_around(filled, len(profile) / 90))


def drape_coefficients(
    radius: np.ndarray, plate: np.ndarray | float, disc: np.ndarray | bool
) -> np.ndarray:
    """(N,) drape coefficients of outlines (N, AZIMUTHS) in half sizes (m/m); ``plate``: (N,)
    diameters in sizes; NaN where less than half of an outline is seen."""
    seen = np.isfinite(radius)
    # Where it is not seen, the mean of the rest.
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        squares = np.nanmean(np.square(np.maximum(radius, np.reshape(plate, (-1, 1)))), axis=1)
    held = np.pi * np.square(plate)
    whole = np.where(disc, np.pi, 4.0)
    return np.where(seen.mean(axis=1) >= 0.5, (np.pi * squares - held) / (whole - held), np.nan)


def outline_of_curve(
    curve: Outline, *, zero: Radians = 0.0, height: Metres = np.inf,
    error: np.ndarray | None = None
) -> DrapeOutline:
    """Outline of a curve about the plate's centre; where a ray from the centre crosses it several
    times, the outermost crossing counts. ``error``: (N,) m, standard deviations of its radii at
    equal steps of azimuth."""
    if error is not None:
        error = np.interp(zero + AZIMUTH, np.arange(len(error)) * (2 * np.pi / len(error)), error,
                          period=2 * np.pi)
    return DrapeOutline(_radii(closed(curve), zero), height, error)


def outline_of_map(drape: RadialMap, rig: Rig) -> DrapeOutline:
    """Outline of a depth capture: its visible cloth, seen from infinitely far above."""
    borders = elevations(rig)
    flat = drape.distance * np.cos((borders[1:] + borders[:-1]) / 2)
    radius = np.where(drape.weight > 0, flat, 0.0).max(axis=1)
    # Centres of border pixels are half a pixel inside the hem.
    return DrapeOutline(np.where(radius > 0, radius + PIXEL / 2, np.nan))


def contour(positions: Points, mesh: Mesh, height: Metres) -> Edges:
    """Edges that a drape's outline from any height of at least ``height`` is made of: those of the
    border, and those between a triangle that may be seen from above and one that may be seen from
    below."""
    a, b, c = (positions[mesh.faces[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    # Of the normal with the direction to a camera on the axis, over the camera's height: linear in
    # the height's inverse.
    above = normal[:, 2]
    near = above - (normal * a).sum(axis=1) / height
    up = (above > 0) | (near > 0)
    down = (above <= 0) | (near <= 0)
    first, second = mesh.edge_faces.T
    return mesh.edges[(second < 0) | (up[first] & down[second]) | (down[first] & up[second])]


def silhouettes(
    positions: Points, edges: Edges, heights: np.ndarray, *, zero: Radians
) -> np.ndarray:
    """(H, AZIMUTHS) m: radii of a drape's outline from each of ``heights`` (H,) above the plate."""
    seen = [positions[:, :2] / (1 - positions[:, 2:] / height) for height in heights]
    return np.array([_radii(flat[edges], zero) for flat in seen])


def _radii(segments: np.ndarray, zero: Radians) -> Radii:
    """Radii of the outermost of segments (N, 2, 2) by azimuth, such that the area is that inside.
    """
    count = AZIMUTHS * _FINE
    turn = zero + np.pi / count
    cos, sin = np.cos(turn), np.sin(turn)
    fine = farthest(segments @ np.array([[cos, -sin], [sin, cos]]), count)
    return np.sqrt(np.square(fine).reshape(AZIMUTHS, _FINE).mean(axis=1))
