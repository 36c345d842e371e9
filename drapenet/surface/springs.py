"""Simulated cloth placed on a captured surface and pulled onto it.

Points of the captured surface give its distance in each direction from a point on the axis. Every
point of the specimen is placed on it at its azimuth, at its arc length from the plate's rim:
strained and bent locally, but with the captured folds. Springs pull vertices towards the planes
through their nearest captured points, preferably those with a similar normal, so that the two sides
of a fold are distinguished.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import RegularGridInterpolator
from scipy.ndimage import gaussian_filter
from scipy.spatial import cKDTree

from common.types import Metres, Points, Radians, RestPoints
from drapenet.views.radial_map import smoothed_map
from sim.cloth import Cloth, Laws
from sim.draping import Drape
from sim.energies.base import Energy
from sim.energies.hinges import Hinges, hinge_angles
from sim.equilibrium import Equilibrium, find_equilibrium
from sim.material import REFERENCE_DENSITY, Fabric
from sim.mesh import adjacency, smooth, vertex_normals
from sim.mesh.specimen import coarse_to_fine
from sim.rig import Rig
from sim.scene import Scene, make_specimen
from sim.solver.newton import NewtonOptions
from sim.solver.state import State
from sim.start import interpolate_positions

AZIMUTHS, ELEVATIONS = 120, 72
CENTRE = -0.06  # m, height of the point that the drape is seen from
STEP = 2e-3  # m, along the traced curves
_SIGMAS = (0.7, 2.0, 6.0, 20.0)  # cells, of the Gaussians that smooth and fill the surface
_LOWEST = -np.pi / 3  # elevation of the lowest direction
_ROWS = _LOWEST + (np.arange(ELEVATIONS) + 0.5) * (np.pi / 2 - _LOWEST) / ELEVATIONS
_COARSE_MEMBRANE = 0.1  # relative to the final one; softer, cloth would stretch to the points
MAX_HINGE_ANGLE = 1.5  # rad; beyond, soft fabrics on narrow folds intersect themselves
_SMOOTHINGS = 50
PULLS = (3.0, 10.0, 10.0)  # force of the springs at 1 mm, over the cloth's weight, in turn
REACH = 0.02  # m, maximum distance of a vertex from its captured point
NORMAL_LENGTH = 0.03  # m, weight of the normals' difference in the distance
OPTIONS = NewtonOptions(residual=0.3, step=1.0, max_iterations=60)  # loose: an initial guess


def _directions(points: Points) -> tuple[np.ndarray, np.ndarray]:
    """Distance of the surface from the centre by direction (AZIMUTHS, ELEVATIONS), m, without gaps,
    smooth; and elevation (AZIMUTHS,), rad, of the hem.
    """
    radius, height = np.hypot(points[:, 0], points[:, 1]), points[:, 2] - CENTRE
    azimuth = np.arctan2(points[:, 1], points[:, 0]) / (2 * np.pi) % 1 * AZIMUTHS
    elevation = np.arctan2(height, radius)
    row = (elevation - _LOWEST) / (np.pi / 2 - _LOWEST) * ELEVATIONS
    cells = azimuth.astype(int) % AZIMUTHS, row.astype(int).clip(0, ELEVATIONS - 1)
    total, count = np.zeros((2, AZIMUTHS, ELEVATIONS))
    np.add.at(total, cells, np.hypot(radius, height))
    np.add.at(count, cells, 1.0)
    visible = count > 0
    distance = smoothed_map(total / np.maximum(count, 1), visible, _SIGMAS, least=0.1)
    cloth = gaussian_filter(visible.astype(float), 0.7, mode=("wrap", "nearest")) > 0.3
    lowest = np.where(cloth.any(axis=1), cloth.argmax(axis=1), ELEVATIONS)
    return distance, _LOWEST + lowest * (np.pi / 2 - _LOWEST) / ELEVATIONS


def surface_positions(rest: RestPoints, points: Points, rig: Rig) -> np.ndarray:
    """Positions (V, 3), m, of rest points laid on the surface through ``points``, in the axes of
    the specimen."""
    distance, hem = _directions(points)
    plate = rig.plate_radius
    beyond = np.linalg.norm(rest, axis=1) - plate
    arcs = np.arange(0, beyond.max() + 2 * STEP, STEP)
    curves = np.stack([_curve(*row, plate, arcs) for row in zip(distance, hem, strict=True)])
    # Around the circle, with the first azimuth repeated behind the last.
    grid = 2 * np.pi * (np.arange(-1, AZIMUTHS + 1) + 0.5) / AZIMUTHS
    look_up = RegularGridInterpolator(
        (grid, arcs), np.concatenate([curves[-1:], curves, curves[:1]]), bounds_error=False,
        fill_value=None)
    azimuth = np.arctan2(rest[:, 1], rest[:, 0]) % (2 * np.pi)
    radius, height = look_up(np.column_stack([azimuth, np.maximum(beyond, 0.0)])).T
    placed = np.column_stack([radius * np.cos(azimuth), radius * np.sin(azimuth), height])
    inside = beyond <= 0
    placed[inside] = rig.place(rest[inside])
    return placed


def _curve(distance: np.ndarray, hem: Radians, plate: Metres, arcs: np.ndarray) -> np.ndarray:
    """Radius and height (A, 2), m, at arc lengths (A,) from the rim along one azimuth."""
    radius = distance * np.cos(_ROWS)
    height = distance * np.sin(_ROWS) + CENTRE
    down = (radius > plate) & (_ROWS > hem) & (_ROWS < np.arctan2(-CENTRE, plate))
    radius = np.concatenate([[plate], radius[down][::-1]])
    height = np.concatenate([[0.0], np.minimum(height[down][::-1], 0.0)])
    length = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(radius), np.diff(height)))])
    # Extrapolate beyond the hem with the slope of the last two centimetres.
    end = length[-1]
    back = max(end - 0.02, 0.0)
    slope = (np.array([radius[-1] - np.interp(back, length, radius),
                       height[-1] - np.interp(back, length, height)]) / (end - back)
             if end > 0 else np.array([0.0, -1.0]))
    curve = np.column_stack([np.interp(arcs, length, radius), np.interp(arcs, length, height)])
    return curve + np.maximum(arcs - end, 0.0)[:, None] * slope


class Springs(Energy):
    """Springs from N vertices to planes: sum of ½ k (n·(x - c))²; one element per vertex.

    ``targets``: c; ``normals``: (N, 3), n; ``stiffness``: (N,) N/m, k.
    """

    def __init__(
        self, vertices: np.ndarray, targets: Points, normals: np.ndarray, stiffness: np.ndarray
    ) -> None:
        self.dofs = 3 * vertices[:, None] + np.arange(3)
        self._targets, self._normals, self._stiffness = targets, normals, stiffness

    def _distance(self, q: np.ndarray) -> np.ndarray:
        return (self._normals * (q[self.dofs] - self._targets)).sum(1)

    def value(self, q: np.ndarray) -> float:
        return 0.5 * float(self._stiffness @ self._distance(q) ** 2)

    def gradient(self, q: np.ndarray) -> np.ndarray:
        return (self._stiffness * self._distance(q))[:, None] * self._normals

    def hessian(self, q: np.ndarray, convex: bool = False) -> np.ndarray:
        return (self._stiffness[:, None, None]
                * self._normals[:, :, None] * self._normals[:, None, :])


@dataclass(frozen=True)
class Surface:
    """Captured points and normals (N, 3) in the specimen's axes."""

    points: Points
    normals: np.ndarray
    rig: Rig

    def place(self, rest: RestPoints) -> Points:
        """Positions of rest points: strained and bent locally, but with the captured folds."""
        return surface_positions(rest, self.points, self.rig)

    def springs(self, scene: Scene, positions: Points, pull: float) -> Springs:
        """Springs from vertices at ``positions``; ``pull``: see :func:`springs_to`."""
        near, at = nearest_points(scene, positions, self.points, self.normals, reach=REACH)
        return springs_to(self.points[at], self.normals[at], scene, near, pull)


def captured_shape(fabric: Fabric, surface: Surface, *, edge: Metres) -> Drape:
    """A specimen of ``fabric`` pulled to a ``surface``: an initial guess, no equilibrium without
    the springs.
    """
    laws, rig = Laws(), surface.rig
    coarse = None
    for level in coarse_to_fine(edge):
        last = level == edge
        scene = make_specimen(rig, edge=level)
        rest = scene.mesh.rest
        positions = interpolate_positions(*coarse, rest) if coarse else surface.place(rest)
        positions[scene.held] = rig.place(rest[scene.held])
        if coarse is None:
            positions = uncrumpled(scene, positions)
        equilibrium = pulled(
            scene, fabric, scene.state(positions), surface,
            laws=laws if last else laws.softened(_COARSE_MEMBRANE),
            pulls=PULLS[:2] if coarse is None else PULLS[-2:])
        coarse = rest, equilibrium.state.positions
    return Drape(fabric=fabric, rig=rig, edge=edge, cloth=Cloth(scene, fabric, laws),
                 state=equilibrium.state)


def uncrumpled(scene: Scene, positions: Points) -> Points:
    """Positions, smooth around hinges bent beyond :data:`MAX_HINGE_ANGLE`."""
    mesh, x = scene.mesh, positions.copy()
    adjacent = adjacency(mesh)
    hinges = Hinges(mesh, scene.active)
    for _ in range(_SMOOTHINGS):
        bent = np.abs(hinge_angles(x.ravel(), hinges.dofs)) > MAX_HINGE_ANGLE
        if not bent.any():
            break
        moving = np.zeros(len(x), dtype=bool)
        moving[hinges.corners[bent]] = True
        moving &= ~scene.held
        smooth(x, moving, adjacent)
    return x


def pulled(
    scene: Scene, fabric: Fabric, state: State, surface: Surface, *, laws: Laws,
    pulls: Sequence[float],
) -> Equilibrium:
    """Equilibrium under springs to what is nearest before each of ``pulls``."""
    for pull in pulls:
        springs = surface.springs(scene, state.positions, pull)
        equilibrium = find_equilibrium(scene, fabric, state, laws=laws, extra=[springs],
                                       options=OPTIONS)
        state = equilibrium.state
    return equilibrium


def nearest_points(
    scene: Scene, positions: Points, points: np.ndarray, normals: np.ndarray, *, reach: Metres
) -> tuple[np.ndarray, np.ndarray]:
    """Free vertices (n,) within ``reach`` of a captured surface, and the captured point of each;
    the surface has ``points`` (M, 3), m, and ``normals`` (M, 3)."""
    tree = cKDTree(np.hstack([points, NORMAL_LENGTH * normals]))
    free = np.flatnonzero(~scene.held)
    unit = vertex_normals(positions, scene.mesh.faces)[free]
    distance, nearest = tree.query(np.hstack([positions[free], NORMAL_LENGTH * unit]))
    near = distance < reach
    return free[near], nearest[near]


def plane_springs(scene: Scene, positions: Points, *, pull: float) -> Springs:
    """Springs from each free vertex to the tangent plane at its position on a surface."""
    free = np.flatnonzero(~scene.held)
    normals = vertex_normals(positions, scene.mesh.faces)[free]
    return springs_to(positions[free], normals, scene, free, pull)


def springs_to(
    targets: Points, normals: np.ndarray, scene: Scene, vertices: np.ndarray, pull: float
) -> Springs:
    """Springs from ``vertices`` (N,); ``pull``: force at 1 mm over their weight at 300 g/m²."""
    weight = REFERENCE_DENSITY * scene.gravity * scene.mesh.vertex_areas[vertices]
    return Springs(vertices, targets, normals, pull / 1e-3 * weight)
