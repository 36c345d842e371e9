"""Frames in which the Hessian of mid-edge bending couples a triangle with nothing but itself.

A dihedral angle joins four corners, so that with rotations zeta as unknowns
(:mod:`sim.energies.midedge`) a triangle depends on its three neighbours, too: 21 unknowns. A
triangle's angle phi is however that between its own normal and the normal at the middle of the
edge. Let xi be the turn of that middle normal about the edge, against a frame that parallel
transport carries along, and alpha_1, alpha_2 the turns of the two triangles' normals against the
same frame. Then

    dphi_1 = dalpha_1 + dxi,   dphi_2 = dalpha_2 - dxi,   dzeta = dxi + (dalpha_1 - dalpha_2)/2,

and alpha_1 depends on the first triangle alone: 12 unknowns. Moves (dx, dxi) are a linear change
of (dx, dzeta) at each state, so that Newton's steps are the same, but their matrix has half the
entries and its factorisation takes a third of the time. (Grinspun et al. 2006, Computing discrete
shape operators on general meshes, have such normals as unknowns.)
"""

from dataclasses import dataclass

import numba
import numpy as np

from sim.energies import dihedral


@dataclass(frozen=True)
class EdgeFrames:
    """The frames of M edges between two triangles that can move; other rotations need none.

    Attributes:
        dofs: (M, 12) coordinates of the corners of the hinge about each edge, in the order of
            :mod:`sim.energies.dihedral`; the first triangle has zeta in phi_1 = theta/2 + zeta.
        rotations: (M,) the edges' rotations among the unknowns.
        clamped: (C,) coordinates of the triangles beyond clamped edges, which have to be held.
    """

    dofs: np.ndarray
    rotations: np.ndarray
    clamped: np.ndarray

    def levers(self, q: np.ndarray) -> np.ndarray:
        """(M, 12) derivatives of zeta by the coordinates where xi is kept, 1/m, at ``q`` (Q,)."""
        return _levers(q, self.dofs)


@numba.njit(cache=True)
def _levers(q, dofs):
    result = np.empty((len(dofs), 12))
    x, g = np.empty((4, 3)), np.empty((4, 3))
    for e in range(len(dofs)):
        for k in range(12):
            x[k // 3, k % 3] = q[dofs[e, k]]
        g[:, :] = 0.0
        dihedral.add_side_gradient(x, 2, 1.0, g)
        dihedral.add_side_gradient(x, 3, 1.0, g)  # not -1.0: alpha_2 is subtracted
        for k in range(12):
            result[e, k] = 0.5 * g[k // 3, k % 3]
    return result
