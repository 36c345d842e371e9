"""Differences between two drapes of one specimen: displacement, mean curvature and folds."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from common.errors import InputError
from common.types import Faces, Metres, Points, RestPoints
from sim.measures import fold_angles
from sim.mesh import Mesh
from sim.start import interpolate_positions

_MAX_FOLD_SHIFT = 0.25
"""Largest shift of a fold, as a fraction of the mean angle between folds."""
_AREA_TOLERANCE = 0.03  # relative difference of area; the boundary of a coarse disc is a polygon


class Draped(Protocol):
    """Shape of a specimen, for example a :class:`sim.draping.Drape`."""

    rest: RestPoints
    positions: Points
    faces: Faces


@dataclass(frozen=True)
class Difference:
    """Difference of two drapes: both metrics of the paper's Table 3, and the largest displacement.

    ``curvature`` is the area average of |H_other - H_reference| divided by that of |H_reference|;
    infinite if the reference is flat.
    """

    displacement: Metres
    largest: Metres
    curvature: float

    @property
    def row(self) -> list[float]:
        """Displacement in mm and curvature in percent."""
        return [1e3 * self.displacement, 100 * self.curvature]


def compare(reference: Draped, other: Draped, *, turned: bool = False) -> Difference:
    """Compare two drapes of one specimen.

    The material points at the vertices of the coarser mesh are compared, held ones included,
    weighted by their rest areas. The finer drape is interpolated to them unless the meshes are
    equal. Both curvatures are computed on the coarser triangles, because a coarse mesh does not
    resolve bending between its vertices. ``turned``: about the vertical axis, for the best fit.
    """
    coarse, fine = sorted((reference, other), key=lambda drape: len(drape.rest))
    mesh = Mesh(rest=coarse.rest, faces=coarse.faces)
    weight = mesh.vertex_areas
    ratio = Mesh(rest=fine.rest, faces=fine.faces).areas.sum() / weight.sum()
    if abs(ratio - 1) > _AREA_TOLERANCE:
        raise InputError(f"not drapes of one specimen: rest areas differ by {ratio - 1:+.0%}")
    moved = _interpolated(fine, mesh.rest)
    if turned:
        moved = best_turned(moved, coarse.positions, weight)
    distance = np.linalg.norm(moved - coarse.positions, axis=1)
    curvatures = mean_curvature(coarse.positions, mesh), mean_curvature(moved, mesh)
    expected, found = curvatures if coarse is reference else curvatures[::-1]
    known = np.isfinite(expected)
    gap = weight[known] @ np.abs(found - expected)[known]
    size = weight[known] @ np.abs(expected)[known]
    return Difference(
        displacement=float(distance @ weight / weight.sum()),
        largest=float(distance.max()),
        curvature=float(gap / size) if size > 0 else (np.inf if gap > 0 else 0.0),
    )


def _interpolated(drape: Draped, rest: RestPoints) -> Points:
    """Positions of the drape at the material points ``rest``."""
    if np.array_equal(drape.rest, rest):
        return drape.positions
    # The origin of rest coordinates is the plate's axis, not the centre of the specimen.
    centre, middle = ((r.min(axis=0) + r.max(axis=0)) / 2 for r in (rest, drape.rest))
    return interpolate_positions(drape.rest - middle, drape.positions, rest - centre)


def best_turned(positions: Points, target: Points, weight: np.ndarray) -> Points:
    """Positions turned about the vertical axis, for the least sum of squared distances from
    ``target`` with the weights (V,)."""
    # With horizontal positions as complex numbers, the best angle is the phase of the product.
    flat, goal = (p[:, 0] + 1j * p[:, 1] for p in (positions, target))
    product = weight @ (flat.conj() * goal)
    turned = flat * product / abs(product)
    return np.column_stack([turned.real, turned.imag, positions[:, 2]])


def mean_curvature(positions: Points, mesh: Mesh) -> np.ndarray:
    """Mean curvature (V,), 1/m, of the surface through ``positions``.

    Half the sum of the principal curvatures, positive where the surface is convex on the side
    from which its faces are counter-clockwise: 1/R on a sphere seen from outside. Cotangent
    formula with mixed areas (Meyer et al. 2003, the operator of the paper's section 4.2.2), along
    the vertex normal. NaN on the boundary, where the formula is not defined.
    """
    corners = positions[mesh.faces]
    to_next, to_last = (np.roll(corners, -k, axis=1) - corners for k in (1, 2))
    normals = np.cross(to_next, to_last)
    twice = np.linalg.norm(normals, axis=-1)
    cot = (to_next * to_last).sum(-1) / twice
    opposite = to_last - to_next  # from the next corner to the one after it
    flow = cot[..., None] * opposite
    laplacian = _gather(mesh, np.roll(flow, 1, axis=1) - np.roll(flow, 2, axis=1))
    normal = _gather(mesh, normals)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    squared = (opposite**2).sum(-1)
    cone = (np.roll(cot * squared, 1, axis=1) + np.roll(cot * squared, 2, axis=1)) / 8
    blunt = (cot < 0).any(axis=1, keepdims=True)
    share = np.where(cot < 0, 1 / 4, 1 / 8) * twice
    area = _gather(mesh, np.where(blunt, share, cone))
    curvature = -(laplacian * normal).sum(axis=1) / (4 * area)
    curvature[mesh.edges[mesh.edge_faces[:, 1] < 0].ravel()] = np.nan
    return curvature


def _gather(mesh: Mesh, values: np.ndarray) -> np.ndarray:
    """Sums (V, ...) of corner values (F, 3, ...) at each vertex."""
    total = np.zeros((len(mesh.rest), *values.shape[2:]))
    np.add.at(total, mesh.faces, values)
    return total


def same_folds(outline: np.ndarray, other: np.ndarray) -> bool:
    """Whether two drapes have the same fold configuration.

    They have as many folds, and each is within a quarter of the mean fold spacing of its
    counterpart. ``outline`` and ``other`` (720, 2) are from :func:`sim.measures.fold_outline`.
    """
    folds, others = fold_angles(outline), fold_angles(other)
    if len(folds) != len(others):
        return False
    if not len(folds):
        return True
    # Angles wrap around: a fold near 0 may correspond to the last or the next one of the other.
    shifts = [np.roll(others, k) - folds for k in (-1, 0, 1)]
    gap = min(np.abs((shift + np.pi) % (2 * np.pi) - np.pi).max() for shift in shifts)
    return bool(gap < _MAX_FOLD_SHIFT * 2 * np.pi / len(folds))
