"""Captured surfaces: drapes registered to a mesh of the specimen, and point clouds."""

import math
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from common.errors import InputError
from common.types import Faces, Points, RestPoints, VertexMask
from sim.cloth import Cloth
from sim.draping import Drape
from sim.energies.self_contact import contact_near
from sim.material import Fabric
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
        scene = Scene.on(self.rig, mesh, self.held)
        state = scene.state(self.positions)
        contact = contact_near(scene, self.positions).value(state.q)
        return Drape(fabric=fabric, rig=self.rig, edge=float(mesh.edge_lengths.mean()), state=state,
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
