"""Cloth that is not alike everywhere: uneven natural curvature, creases, curled and doubled hems.

The curvature of cloth at rest is a random field of plane waves, whose wave vectors are normally
distributed, so that its correlation at a distance d is exp(-d²/(2 length²)). Bands as narrow as a
hem or a crease are averaged over each triangle.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from common.types import Curvatures, FaceMask, Metres, Radians, RestPoints
from sim.energies.external import Gravity
from sim.material import Fabric
from sim.mesh import Mesh
from sim.rig import GRAVITY

TWIST = 0.5
"""Deviation of the random twist over that of the curvature along a yarn."""
HEM_WIDTH = 15e-3  # m, of the band that is curled
CREASE_WIDTH = 10e-3  # m
_WAVES = 24
_PARTS = 8  # of a triangle's sides, whose 64 parts are looked at
_SPACING = 1e-3  # m, of points along the border


@dataclass(frozen=True)
class Crease:
    """A straight band of natural curvature across it, 1/m, at a ``distance`` from the origin of the
    rest points along the ``azimuth`` from the warp."""

    curvature: float
    azimuth: Radians = 0.0
    distance: Metres = 0.0


@dataclass(frozen=True)
class Uneven:
    """What varies over a specimen.

    Attributes:
        deviation: standard deviation of the random natural curvature along warp and weft each, 1/m.
        length: its correlation length.
        pattern: seed of its waves.
        hem_curl: natural curvature across the hem, 1/m, in a band of :data:`HEM_WIDTH`.
        hem_layers: width of the band at the hem in which the cloth is doubled.
    """

    deviation: float = 0.0
    length: Metres = 0.04
    pattern: int = 0
    hem_curl: float = 0.0
    hem_layers: Metres = 0.0
    creases: tuple[Crease, ...] = ()

    def curvature_at(self, mesh: Mesh, active: FaceMask) -> Curvatures:
        """Natural curvature of the active triangles, 1/m."""
        result = np.zeros((int(active.sum()), 3))
        if self.deviation:
            result += self._random(mesh.rest[mesh.faces[active]].mean(axis=1))
        if not (self.hem_curl or self.creases):
            return result
        points = _parts(mesh, active)
        for crease in self.creases:
            normal = np.array([np.cos(crease.azimuth), np.sin(crease.azimuth)])
            inside = np.abs(points @ normal - crease.distance) < CREASE_WIDTH / 2
            result += crease.curvature * inside.mean(axis=1)[:, None] * _across(normal)
        if self.hem_curl:
            away, outwards = _to_border(mesh, points)
            band = (away < HEM_WIDTH)[..., None] * _across(outwards)
            result += self.hem_curl * band.mean(axis=1)
        return result

    def _random(self, points: RestPoints) -> Curvatures:
        rng = np.random.default_rng([self.pattern, 2])
        waves = rng.standard_normal((3, _WAVES, 2)) / self.length
        phase = rng.uniform(0, 2 * np.pi, (3, _WAVES))
        sums = np.cos(np.einsum("nk,swk->nsw", points, waves) + phase).sum(axis=2)
        return self.deviation * np.sqrt(2 / _WAVES) * np.array([1.0, 1.0, TWIST]) * sums

    def layers_at(self, mesh: Mesh, active: FaceMask) -> np.ndarray:
        """Mean number of layers (N,) of the active triangles."""
        away, _ = _to_border(mesh, _parts(mesh, active))
        return 1.0 + (away < self.hem_layers).mean(axis=1)


@dataclass(frozen=True)
class HemWeight:
    """A law (:class:`sim.cloth.Law`) of the weight of the second layer of a doubled hem."""

    width: Metres

    def __call__(self, mesh: Mesh, active: FaceMask, *, fabric: Fabric) -> Gravity:
        """The energy on ``mesh``."""
        added = mesh.areas[active] * (Uneven(hem_layers=self.width).layers_at(mesh, active) - 1)
        areas = np.bincount(mesh.faces[active].ravel(), np.repeat(added / 3, 3), len(mesh.rest))
        return Gravity(mesh, density=fabric.density, gravity=GRAVITY, areas=areas)


def _across(normal: np.ndarray) -> np.ndarray:
    """The curvatures (..., 3) of unit size across lines with ``normal`` (..., 2)."""
    x, y = normal[..., 0], normal[..., 1]
    return np.stack([x * x, y * y, x * y], axis=-1)


def _parts(mesh: Mesh, active: FaceMask) -> np.ndarray:
    """Centres (N, 64, 2) of the equal parts of the active triangles."""
    steps = 3 * _PARTS
    first, second = np.meshgrid(np.arange(1, steps), np.arange(1, steps))
    third = steps - first - second
    # Centres of the triangles of a grid: all coordinates leave one third, or all two.
    centres = (third > 0) & (first % 3 == second % 3) & (first % 3 != 0) & (third % 3 == first % 3)
    weights = np.stack([part[centres] for part in (first, second, third)], axis=1) / steps
    return np.einsum("pk,nkd->npd", weights, mesh.rest[mesh.faces[active]])


def _to_border(mesh: Mesh, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distances (N, P), m, of points (N, P, 2) to the border of the cloth, and the directions
    (N, P, 2) to it."""
    start, end = (mesh.rest[mesh.edges[mesh.edge_faces[:, 1] < 0][:, k]] for k in (0, 1))
    count = max(2, round(float(np.linalg.norm(end - start, axis=1).max()) / _SPACING))
    share = (np.arange(count) / count)[:, None, None]
    border = (start + share * (end - start)).reshape(-1, 2)
    away, nearest = cKDTree(border).query(points)
    return away, (border[nearest] - points) / np.maximum(away, 1e-12)[..., None]
