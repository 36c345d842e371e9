"""Captured surfaces: registered drapes, the objective for them, and point clouds."""

import math
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from common.errors import InputError
from common.types import Faces, Metres, Points, RestPoints, VertexMask
from drapenet.refine.objective import Linearised, Moves, Nuisance, Residuals, huber
from sim.cloth import Cloth
from sim.drape import Drape
from sim.energies.self_contact import contact_near
from sim.material import Fabric
from sim.measures import drape_coefficient
from sim.mesh import Mesh, edges_of, vertex_normals
from sim.rig import Rig
from sim.scene import Scene

_ON_PLATE = 1.003  # of the plate's radius: vertices on its rim are held
NEIGHBOURS = 20  # used to estimate the normal of a raw point


@dataclass(frozen=True)
class CapturedShape:
    """A registered drape on a plate, with rest points in any material axes."""

    positions: Points
    rest: RestPoints
    faces: Faces
    rig: Rig

    @property
    def held(self) -> VertexMask:
        """Vertices that the plate holds."""
        return np.linalg.norm(self.rest, axis=1) <= _ON_PLATE * self.rig.plate_radius

    @property
    def hanging(self) -> VertexMask:
        """Vertices beyond the plate."""
        return ~self.held

    @property
    def strain(self) -> float:
        """Root mean square strain of the hanging edges."""
        edges = edges_of(self.faces)[0]
        edges = edges[self.hanging[edges].any(axis=1)]
        length, rest = (np.linalg.norm(p[edges[:, 0]] - p[edges[:, 1]], axis=1)
                        for p in (self.positions, self.rest))
        return float(np.sqrt(np.mean((length / rest - 1) ** 2)))

    def as_drape(self, fabric: Fabric) -> Drape:
        """The shape as a drape of ``fabric``, not in equilibrium."""
        mesh = Mesh(self.rest, self.faces)
        ends = mesh.rest[mesh.edges]
        lengths = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
        scene = Scene.on(self.rig, mesh, self.held)
        state = scene.state(self.positions)
        contact = contact_near(scene, self.positions).value(state.q)
        return Drape(fabric=fabric, rig=self.rig, edge=float(lengths.mean()), state=state,
                     cloth=Cloth(scene, fabric), touches=0 < contact < math.inf)


@dataclass(frozen=True)
class Cloud:
    """A scanned surface: points, and normals (N, 3) of either sign."""

    points: Points
    normals: np.ndarray

    @staticmethod
    def of_mesh(positions: Points, faces: Faces) -> "Cloud":
        """Vertices, edge and face midpoints of a scanned mesh."""
        vertices, edges = vertex_normals(positions, faces), edges_of(faces)[0]
        points = [positions, positions[edges].mean(axis=1), positions[faces].mean(axis=1)]
        normals = np.concatenate([vertices, vertices[edges].sum(axis=1),
                                  vertices[faces].sum(axis=1)])
        length = np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
        return Cloud(np.concatenate(points), normals / length)

    @staticmethod
    def of_points(points: Points) -> "Cloud":
        """A raw point cloud, with normals estimated from neighbours."""
        if len(points) < (least := 10 * NEIGHBOURS):
            raise InputError(f"{len(points)} points are too few for a surface, at least {least} "
                             "are needed; scan more densely")
        _, near = cKDTree(points).query(points, NEIGHBOURS + 1)
        offsets = points[near[:, 1:]] - points[:, None]
        centred = offsets - offsets.mean(axis=1, keepdims=True)
        frames = np.linalg.eigh(np.einsum("nki,nkj->nij", centred, centred))[1]
        return Cloud(points, frames[:, :, 0])


def distances(cloud: Cloud, positions: Points) -> np.ndarray:
    """Distances (N,), m, of points from a scanned surface."""
    tree = cKDTree(cloud.points)
    distance, nearest = tree.query(positions)
    across = np.abs((cloud.normals[nearest] * (positions - cloud.points[nearest])).sum(1))
    # Normal distance near the surface, Euclidean distance beyond the hem.
    spacing = tree.query(cloud.points, 2)[0][:, 1].max()
    return np.where(distance < spacing, across, distance)


@dataclass(frozen=True)
class Fidelity:
    """Comparison of a released drape with its captured shape (Feng et al. 2022, section 7.2)."""

    displacement_mm: float  # mean of hanging vertices from their captured positions
    surface_mm: float  # mean of hanging vertices from the captured surface
    coefficient: float  # drape coefficient, percent
    captured_coefficient: float


def fidelity(shape: CapturedShape, drape: Drape) -> Fidelity:
    """Compare ``drape``, released from ``shape`` on the same mesh, with it."""
    hanging, settled = shape.hanging, drape.positions
    surface = Cloud.of_mesh(shape.positions, shape.faces)
    return Fidelity(
        1e3 * float(np.linalg.norm(settled - shape.positions, axis=1)[hanging].mean()),
        1e3 * float(distances(surface, settled[hanging]).mean()),
        *(100 * drape_coefficient(x, shape.faces, shape.rig) for x in (settled, shape.positions)))


class RobustPositions:
    """Objective: robust distances between vertices and their captured positions.

    Its value is half the mean of Huber's function, linear beyond ``limit``, of the distances of
    ``vertices`` (V,) in units of ``sigma``, times the number of ``independent`` ones.
    """

    nuisances = ()
    start = scale = deviation = np.zeros(0)

    def __init__(
        self, target: Points, *, vertices: VertexMask, sigma: Metres = 2e-3, limit: float = 1.0,
        independent: float = 100.0,
    ) -> None:
        self._target, self._vertices = target, np.flatnonzero(vertices)
        self._sigma, self._limit = sigma, limit
        self._independent = independent
        self._factor = math.sqrt(independent / len(self._vertices))

    def residuals(self, positions: Points, nuisance: Nuisance) -> Residuals:
        """Three residuals for each vertex."""
        return self._bent(positions)[0].ravel()

    def linearised(self, positions: Points, nuisance: Nuisance) -> Linearised:
        residuals, scale, across = self._bent(positions)

        def along(moves: Moves) -> np.ndarray:
            chosen = moves[:, self._vertices]
            inward = (across * chosen).sum(-1, keepdims=True)
            return (scale[:, None] * chosen + residuals * inward).reshape(len(moves), -1).T

        return Linearised(residuals.ravel(), along, np.zeros((residuals.size, 0)),
                          self._independent)

    def _bent(self, positions: Points) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Residuals (N, 3), their factor (N,), and its relative derivative by the gap (N, 3)."""
        gap = (positions - self._target)[self._vertices]
        distance = np.maximum(np.linalg.norm(gap, axis=1) / self._sigma, 1e-12)
        bent, slope = huber(distance, self._limit)
        scale = bent / distance * self._factor / self._sigma
        # d log(bent/d)/dd, along the gap's direction
        across = ((slope / bent - 1 / distance) / distance)[:, None] * gap / self._sigma**2
        return scale[:, None] * gap, scale, across
