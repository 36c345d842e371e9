"""A captured surface whose points belong to no known points of the cloth."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from common.errors import InputError
from sim.mesh import edges_of, vertex_normals

NEIGHBOURS = 20  # that a raw point's normal is taken from


@dataclass(frozen=True)
class Cloud:
    """A scanned surface.

    Attributes:
        points: (N, 3) m; normals: (N, 3) of either sign.
    """

    points: np.ndarray
    normals: np.ndarray

    @staticmethod
    def of_mesh(positions: np.ndarray, faces: np.ndarray) -> "Cloud":
        """Vertices, middles of edges and of faces of a scanned mesh, (V, 3) m and (F, 3)."""
        vertices, edges = vertex_normals(positions, faces), edges_of(faces)[0]
        points = [positions, positions[edges].mean(axis=1), positions[faces].mean(axis=1)]
        normals = np.concatenate([vertices, vertices[edges].sum(axis=1),
                                  vertices[faces].sum(axis=1)])
        length = np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
        return Cloud(np.concatenate(points), normals / length)

    @staticmethod
    def of_points(points: np.ndarray) -> "Cloud":
        """A raw cloud (N, 3), m: normals from each point's neighbours.

        Raises:
            InputError: too few points.
        """
        if len(points) < 10 * NEIGHBOURS:
            raise InputError(f"{len(points)} points are too few for a surface")
        _, near = cKDTree(points).query(points, NEIGHBOURS + 1)
        offsets = points[near[:, 1:]] - points[:, None]
        centred = offsets - offsets.mean(axis=1, keepdims=True)
        frames = np.linalg.eigh(np.einsum("nki,nkj->nij", centred, centred))[1]
        return Cloud(points, frames[:, :, 0])


def distances(cloud: Cloud, positions: np.ndarray) -> np.ndarray:
    """Distances (N,), m, of points (N, 3) from a scanned surface."""
    distance, nearest = cKDTree(cloud.points).query(positions)
    across = np.abs((cloud.normals[nearest] * (positions - cloud.points[nearest])).sum(1))
    # Next to a point of the surface only what lies across counts, beyond the hem all of it.
    spacing = cKDTree(cloud.points).query(cloud.points, 2)[0][:, 1].max()
    return np.where(distance < spacing, across, distance)
