"""How far two drapes of one specimen lie apart: vertices, mean curvature, folds."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from common.errors import InputError
from sim.initial import interpolate_positions
from sim.measures import fold_angles
from sim.mesh import Mesh

ALIGNMENTS = ("none", "turn", "rigid")
_FOLD_SHIFT = 0.25
"""How far a fold may lie from its partner, as a fraction of the mean distance between folds."""
_SAME_AREA = 0.03  # relative; the border of a coarse disc is a polygon


class Draped(Protocol):
    """A specimen's shape; :class:`sim.drape.DrapeResult` is one.

    ``positions`` (V, 3) m, ``rest`` (V, 2) m and ``faces`` (F, 3).
    """

    positions: np.ndarray
    rest: np.ndarray
    faces: np.ndarray


@dataclass(frozen=True)
class Difference:
    """What lies between two drapes: the two metrics of the paper's Table 3, and the worst vertex.

    Attributes:
        displacement: mean distance between the two positions of a material point, m.
        largest: the largest such distance, m.
        curvature: relative difference of the mean curvature, 0.05 for 5 %: the area's mean of
            |H_other - H_reference| over that of |H_reference|. The paper does not say what its
            figures are relative to. A quotient at each point would be large wherever the cloth
            is flat. Infinite if the whole reference is.
    """

    displacement: float
    largest: float
    curvature: float


def compare(reference: Draped, other: Draped, *, align: str = "none") -> Difference:
    """Compare two drapes of one specimen, after the best rigid motion if asked for.

    Compared are the points of the cloth at the vertices of the coarser mesh, each with the rest
    area around it as its weight, held ones included. The finer drape is interpolated to them
    unless the meshes are the same, and both curvatures are taken on the coarser triangles: a
    coarse mesh does not know how the cloth bends between its vertices.

    Args:
        align: "none"; "turn", the best rotation about the vertical axis; "rigid", the best
            rotation and translation.

    Raises:
        InputError: unknown alignment, or specimens of different sizes.
    """
    coarse, fine = sorted((reference, other), key=lambda drape: len(drape.rest))
    mesh = Mesh(rest=coarse.rest, faces=coarse.faces)
    weight = mesh.vertex_areas
    ratio = Mesh(rest=fine.rest, faces=fine.faces).areas.sum() / weight.sum()
    if abs(ratio - 1) > _SAME_AREA:
        raise InputError(f"not drapes of one specimen: rest areas differ by {ratio - 1:+.0%}")
    moved = align_positions(_at_rest_points(fine, mesh.rest), coarse.positions, weight, align=align)
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


def _at_rest_points(drape: Draped, rest: np.ndarray) -> np.ndarray:
    """Positions (V, 3) of the drape where ``rest`` (V, 2) lies on its specimen."""
    if np.array_equal(drape.rest, rest):
        return drape.positions
    # The origin of rest coordinates is the plate's axis, which need not be the centre.
    centre, own = ((r.min(axis=0) + r.max(axis=0)) / 2 for r in (rest, drape.rest))
    return interpolate_positions(drape.rest - own, drape.positions, rest - centre)


def align_positions(
    positions: np.ndarray, target: np.ndarray, weight: np.ndarray, *, align: str
) -> np.ndarray:
    """Positions (V, 3) moved as close as possible to ``target`` (V, 3), see :func:`compare`.

    Minimises the sum of squared distances, weighted by ``weight`` (V,).
    """
    if align == "none":
        return positions
    if align == "turn":
        # Seen from above as complex numbers, the best turn is the phase of their product.
        flat, goal = (p[:, 0] + 1j * p[:, 1] for p in (positions, target))
        product = weight @ (flat.conj() * goal)
        turned = flat * product / abs(product)
        return np.column_stack([turned.real, turned.imag, positions[:, 2]])
    if align == "rigid":
        share = weight / weight.sum()
        middle, goal = share @ positions, share @ target
        u, _, vt = np.linalg.svd((positions - middle).T * share @ (target - goal))
        proper = np.array([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])  # no reflection
        return (positions - middle) @ (u * proper) @ vt + goal
    raise InputError(f"unknown alignment '{align}'; choose from {', '.join(ALIGNMENTS)}")


def mean_curvature(positions: np.ndarray, mesh: Mesh) -> np.ndarray:
    """Mean curvature (V,), 1/m, of the surface through positions (V, 3), m.

    Half the sum of the principal curvatures, positive where the surface bulges to the side from
    which its faces run counter-clockwise: 1/R on a sphere seen from outside. Cotangent formula
    with mixed areas (Meyer et al. 2003, the operator of the paper's section 4.2.2), along the
    vertex normal. NaN on the border, where the formula says nothing.
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
    """Sums (V, ...) over the corners at each vertex of values (F, 3, ...)."""
    total = np.zeros((len(mesh.rest), *values.shape[2:]))
    np.add.at(total, mesh.faces, values)
    return total


def same_folds(outline: np.ndarray, other: np.ndarray) -> bool:
    """Whether two drapes hang in the same fold configuration.

    As many folds, each within a quarter of the mean fold distance of its partner in the other
    drape. ``outline`` and ``other`` (720, 2) as :func:`sim.measures.fold_outline` gives them.
    """
    folds, others = fold_angles(outline), fold_angles(other)
    if len(folds) != len(others):
        return False
    if not len(folds):
        return True
    # A fold near the seam may have its partner beyond it: try the pairings next to the plain one.
    shifts = [np.roll(others, k) - folds for k in (-1, 0, 1)]
    gap = min(np.abs((shift + np.pi) % (2 * np.pi) - np.pi).max() for shift in shifts)
    return bool(gap < _FOLD_SHIFT * 2 * np.pi / len(folds))


def best_turn(outline: np.ndarray, other: np.ndarray) -> float:
    """By what angle, radians, ``other`` must turn to match ``outline``, both (720, 2) m.

    The specimen turns with its drape, as it may when neither its shape nor its cloth has a
    direction: a disc of an isotropic fabric. Least squares, to half a degree.
    """
    spin = np.exp(-2j * np.pi * np.arange(len(outline)) / len(outline))
    one, two = ((o[:, 0] + 1j * o[:, 1]) * spin for o in (outline, other))
    match = np.fft.ifft(np.fft.fft(one) * np.fft.fft(two).conj()).real
    return float(match.argmax() * 2 * np.pi / len(outline))
