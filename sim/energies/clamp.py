"""Areas that integrate the bending energy to higher order next to a clamp."""

import numpy as np

from sim.mesh import Mesh

FIRST = 6 / 5
"""Stiffness of the row of triangles that hang on clamped edges, relative to their area's."""


def bending_areas(mesh: Mesh, active: np.ndarray, clamped: np.ndarray) -> np.ndarray:
    """Areas (N,), m², with which the active triangles count in the bending energy.

    Clamped cloth turns at its edges: half a hinge at the clamp, whole ones behind it, so that the
    slope far out is the trapezoidal rule's integral of the curvature. The error of that rule is
    h²/12 times the curvature's slope at its ends, which vanishes at a free end but not at a clamp.
    Gregory's weights 5/12, 13/12 in place of 1/2, 1 cancel it. Weights of a curvature are
    compliances: triangles on clamped edges get 5/6 of theirs, the next, which touch the clamp with
    a corner, as much more as leaves the sum unchanged.

    Args:
        active: (F,) bool, triangles that store energy.
        clamped: (N, 3) bool, which of their edges adjoin held triangles.
    """
    areas = mesh.areas[active].copy()
    first = clamped.any(axis=1)
    rim = np.zeros(len(mesh.rest), dtype=bool)
    rim[mesh.edges[mesh.face_edges[active][clamped]]] = True
    second = rim[mesh.faces[active]].any(axis=1) & ~first
    if first.any() and second.any():
        moved = (1 - 1 / FIRST) * areas[first].sum() / areas[second].sum()
        areas[first] *= FIRST
        areas[second] /= 1 + moved
    return areas
