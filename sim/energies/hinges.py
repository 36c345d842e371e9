"""Hinge energies: every edge stores an energy of the dihedral angle of its two triangles.

For comparison, and for export to simulators that use them. Their moduli are not physical: the
stiffness of a strip of hinges depends on its triangulation and does not converge under refinement
(docs/physics.md). For an edge between held and free cloth, H is the height of the free triangle,
not the sum of two heights.

In all hinge laws a hinge with the dihedral angle theta and the rest edge e carries the torque
tau = (a c + b c²) e, but their definitions of the curvature c differ. Here (Feng et al. 2022,
section 4.2.1) it is kappa = 2 theta / (H0 + H1) with the rest heights H of the two triangles. In
another convention c = f kappa, so that equal torques on a mesh need a = alpha/f and b = beta/f²:

=================  =======================  ===  ===========  ============
convention         curvature c              f    a            b
=================  =======================  ===  ===========  ============
ARCSim             theta / (2 (H0 + H1))    1/4  4 alpha      16 beta
discrete shells    6 theta / (H0 + H1)      3    alpha / 3    beta / 9
=================  =======================  ===  ===========  ============

*ARCSim*'s (Narain et al. 2012) k may come from a table over kappa: k(kappa) = 4 (alpha + beta
kappa). *Discrete shells* (Grinspun et al. 2003) have the energy a theta² e / (2 h), h =
(H0 + H1)/6; codes with a theta² e / h need half of a: alpha / 6.
"""

import numba
import numpy as np

from common.types import FaceMask, StateVector
from sim.energies import dihedral
from sim.energies.base import FusedEnergy, add_elements
from sim.material import BIAS, WARP, WEFT, Fabric, bending_work
from sim.mesh import Mesh


class Hinges:
    """The N edges between two triangles, at least one of them active, in the order of the mesh.

    Attributes:
        corners: (N, 4) vertices in the order of :mod:`sim.energies.dihedral`: the edge's ends,
            then the opposite corners, that of a triangle that can move first.
        dofs: (N, 12) unknowns of the corners.
        lengths, normals: (N,) m, rest lengths of the edges, and (N, 2) unit vectors across them.
        areas: (N,) m², rest areas of the triangles that can move.
    """

    def __init__(self, mesh: Mesh, active: FaceMask) -> None:
        pair = mesh.edge_faces
        edge = np.flatnonzero((pair[:, 1] >= 0) & active[pair].any(axis=1))
        pair = pair[edge]
        pair = np.where(active[pair[:, :1]], pair, pair[:, ::-1])
        # Corners of the first triangle in cyclic order, starting opposite the edge
        side = (mesh.face_edges[pair[:, 0]] == edge[:, None]).argmax(axis=1)
        opposite, start, end = mesh.faces[pair[:, :1], (side[:, None] + np.arange(3)) % 3].T
        across = mesh.faces[pair[:, 1]].sum(axis=1) - start - end
        self.corners = np.stack([start, end, opposite, across], axis=1)
        self.dofs = (3 * self.corners[:, :, None] + np.arange(3)).reshape(-1, 12)
        x, y = (mesh.rest[end] - mesh.rest[start]).T
        self.lengths = np.hypot(x, y)
        self.normals = np.stack([y, -x], axis=1) / self.lengths[:, None]
        self.areas = (mesh.areas[pair] * active[pair]).sum(axis=1)


class HingeBending(FusedEnergy):
    """Energy e integral of tau(kappa) d theta of all hinges (Feng et al. 2022, Eq. 1 to 3), with
    the moduli of the ``fabric`` averaged over all directions or, if ``directed``, those across the
    edge (Wang et al. 2011); ``linear``: without beta.

    The modulus along the curvature of an earlier solution (section 4.4) is omitted: its torque
    does not derive from an energy.
    """

    def __init__(
        self, mesh: Mesh, active: FaceMask, *, fabric: Fabric, directed: bool = False,
        linear: bool = False
    ) -> None:
        hinges = Hinges(mesh, active)
        angle = np.arctan2(hinges.normals[:, 1], hinges.normals[:, 0])
        self._alpha, self._beta = (
            modulus_along(moduli, angle) if directed else np.full(len(angle), mean_modulus(moduli))
            for moduli in (fabric.alpha, 0.0 * fabric.beta if linear else fabric.beta))
        self.dofs, self._areas, self._lengths = hinges.dofs, hinges.areas, hinges.lengths
        # kappa = spread * |theta|, 1/m per rad; e H / 2 is the area
        self._spread = self._lengths / self._areas

    def _add_forces(self, q: StateVector, targets: np.ndarray, forces: np.ndarray) -> float:
        work, slope, _ = self._of_angles(q)
        add_elements(forces, targets, slope[:, None] * _angle_derivatives(
            q, self.dofs, slope, np.empty((0, 12, 12))))
        return float(work.sum())

    def hessian(self, q: StateVector, convex: bool = False) -> np.ndarray:
        # The torque increases with the angle: only the angle's second derivatives are indefinite.
        _, slope, bend = self._of_angles(q)
        bends = np.zeros((0 if convex else len(slope), 12, 12))
        rows = _angle_derivatives(q, self.dofs, slope, bends)
        blocks = np.einsum("n,ni,nj->nij", bend, rows, rows)
        return blocks if convex else blocks + bends

    def _of_angles(self, q: StateVector) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(N,) energies, J, and their first two derivatives by the dihedral angles."""
        angle = hinge_angles(q, self.dofs)
        work, torque, tangent = bending_work(self._spread * np.abs(angle), self._alpha, self._beta)
        return (self._areas * work, self._lengths * np.sign(angle) * torque,
                self._lengths * self._spread * tangent)


@numba.njit(cache=True)
def hinge_angles(q, dofs):
    """Dihedral angles (N,), rad, of hinges with unknowns ``dofs`` (N, 12) of ``q``."""
    result, corners = np.empty(len(dofs)), q[dofs.ravel()].reshape(-1, 4, 3)
    for t in range(len(dofs)):
        result[t] = dihedral.angle(corners[t])
    return result


@numba.njit(cache=True)
def _angle_derivatives(q, dofs, slope, blocks):
    """Derivatives (N, 12) of the angles by the coordinates of the corners, 1/m; the second ones
    times ``slope`` (N,) are added to ``blocks`` (N, 12, 12) unless these are empty."""
    result, corners = np.zeros((len(dofs), 12)), q[dofs.ravel()].reshape(-1, 4, 3)
    bends = np.empty((4, 4, 3))
    for t in range(len(dofs)):
        x, g = corners[t], result[t].reshape(4, 3)
        for corner in (2, 3):  # the edge has opposite senses in the two triangles
            order = corner - 2, 3 - corner, corner
            edge, arm = x[order[1]] - x[order[0]], x[corner] - x[order[0]]
            unit = np.cross(edge, arm)
            double_area = np.sqrt(unit @ unit)
            unit /= double_area
            levers = dihedral.side_levers(edge, arm, double_area)
            for a in range(3):
                g[order[a]] += levers[a] * unit
            if len(blocks) == 0:
                continue
            bends[:] = 0.0
            dihedral.add_side_bends(edge, arm, slope[t], order, bends)
            for a in range(4):
                for b in range(4):
                    for k in range(3):
                        for m in range(3):
                            blocks[t, 3 * a + k, 3 * b + m] += (
                                unit[k] * bends[a, b, m] + bends[b, a, k] * unit[m])
    return result


def modulus_along(moduli: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Moduli in directions ``angle`` (rad from warp, any shape) of (warp, bias, weft) (3,), N·m or
    N·m² (Feng et al. 2022, Eq. 7 and 8): with c = cos 2 phi the weighted mean

        k = k_bias + max(c, 0) (k_warp - k_bias) + max(-c, 0) (k_weft - k_bias).
    """
    warp, bias, weft = moduli[WARP], moduli[BIAS], moduli[WEFT]
    c = np.cos(2 * np.asarray(angle, float))
    return bias + np.maximum(c, 0) * (warp - bias) + np.maximum(-c, 0) * (weft - bias)


def mean_modulus(moduli: np.ndarray) -> float:
    """Mean of :func:`modulus_along` over all directions: (1 - 2/pi) bias + (warp + weft)/pi.
    ``moduli`` (3,), N·m or N·m²."""
    return float((1 - 2 / np.pi) * moduli[BIAS] + (moduli[WARP] + moduli[WEFT]) / np.pi)


ARCSIM, DISCRETE_SHELLS = 1 / 4, 3.0
"""Factor f of the curvature in other simulators, see the table above."""
