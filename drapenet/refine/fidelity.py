"""Fidelity of an estimate to a captured shape (Feng et al. 2022, section 7.2).

The simulation begins at the captured shape and ends at rest: how far it has gone says how well the
cloth of the estimate explains the capture.
"""

from dataclasses import asdict, dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from drapenet.comparison import compare
from drapenet.refine.captured import CapturedShape
from drapenet.refine.scan import Cloud
from sim.drape import DrapeResult
from sim.measures import drape_coefficient, fold_count


@dataclass(frozen=True)
class Fidelity:
    """A settled drape beside the captured shape it began at.

    Attributes:
        displacement_mm: mean distance of a vertex from where it was captured, of those that hang.
        all_mm: the same of all vertices, those on the plate, which do not move, among them.
        largest_mm: of the vertex that moved furthest.
        surface_mm: mean distance of the hanging vertices from the captured surface, wherever on it.
        curvature: relative difference of the mean curvature, see
            :class:`drapenet.comparison.Difference`.
        coefficient, captured_coefficient: drape coefficients, percent.
        folds, captured_folds: their numbers.
    """

    displacement_mm: float
    all_mm: float
    largest_mm: float
    surface_mm: float
    curvature: float
    coefficient: float
    captured_coefficient: float
    folds: int
    captured_folds: int

    def as_dict(self) -> dict:
        """In JSON's types."""
        return asdict(self)


def fidelity(shape: CapturedShape, drape: DrapeResult) -> Fidelity:
    """How far ``drape``, settled from ``shape`` on the same mesh, is from it."""
    gap = 1e3 * np.linalg.norm(drape.positions - shape.positions, axis=1)
    hanging = shape.hanging
    rig = shape.rig
    return Fidelity(
        displacement_mm=float(gap[hanging].mean()),
        all_mm=float(gap.mean()),
        largest_mm=float(gap.max()),
        surface_mm=float(1e3 * surface_distance(shape, drape.positions)[hanging].mean()),
        curvature=compare(shape, replace(shape, positions=drape.positions)).curvature,
        coefficient=100 * drape_coefficient(drape.positions, drape.faces, rig),
        captured_coefficient=100 * drape_coefficient(shape.positions, shape.faces, rig),
        folds=fold_count(drape.positions, shape.rest, rig),
        captured_folds=fold_count(shape.positions, shape.rest, rig),
    )


def surface_distance(shape: CapturedShape, positions: np.ndarray) -> np.ndarray:
    """Distances (N,), m, of points (N, 3) from the captured surface."""
    return distances(Cloud.of_mesh(shape.positions, shape.faces), positions)


def distances(cloud: Cloud, positions: np.ndarray) -> np.ndarray:
    """Distances (N,), m, of points (N, 3) from a scanned surface."""
    distance, nearest = cKDTree(cloud.points).query(positions)
    across = np.abs((cloud.normals[nearest] * (positions - cloud.points[nearest])).sum(1))
    # Next to a point of the surface only what lies across counts, beyond the hem all of it.
    spacing = cKDTree(cloud.points).query(cloud.points, 2)[0][:, 1].max()
    return np.where(distance < spacing, across, distance)
