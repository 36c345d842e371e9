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

*ARCSim* (Narain et al. 2012) has the energy k e² theta² / (8 A) of a hinge whose two triangles have
the area A = e (H0 + H1)/2: torque k kappa e / 4. Its k may come from a table over kappa; the
law above is then k(kappa) = 4 (alpha + beta kappa).

*Discrete shells* (Grinspun et al. 2003) divide theta by a third of the mean height, (H0 + H1)/6.
The conversion is for the energy a theta² e / (2 h), h = (H0 + H1)/6. Codes with the energy
a theta² e / h need half of a: alpha / 6.
"""

from dataclasses import dataclass

import numba
import numpy as np

from common.types import FaceMask, StateVector
from sim.energies import dihedral
from sim.energies.base import Energy, FusedEnergy, add_elements
from sim.energies.fold_barrier import barrier_at, keeps_distance
from sim.material import BIAS, WARP, WEFT, Fabric, bending_work
from sim.mesh import Mesh


class Hinges:
    """The N edges between two triangles, at least one of them active, in the order of the mesh.

    Attributes:
        edge: (N,) indices among the mesh's edges.
        corners: (N, 4) vertices in the order of :mod:`sim.energies.dihedral`: the edge's ends,
            then the opposite corners, that of a triangle that can move first.
        rest: (N, 4, 2) m, rest points of the corners.
        dofs: (N, 12) unknowns of the corners.
        lengths, normals: (N,) m, rest lengths of the edges, and (N, 2) unit vectors across them.
        areas, bent_areas: (N,) m², rest areas of both triangles, and of those that can move.
    """

    def __init__(self, mesh: Mesh, active: FaceMask) -> None:
        pair = mesh.edge_faces
        self.edge = np.flatnonzero((pair[:, 1] >= 0) & active[pair].any(axis=1))
        pair = pair[self.edge]
        pair = np.where(active[pair[:, :1]], pair, pair[:, ::-1])
        # Corners of the first triangle in cyclic order, starting opposite the edge
        side = (mesh.face_edges[pair[:, 0]] == self.edge[:, None]).argmax(axis=1)
        opposite, start, end = mesh.faces[pair[:, :1], (side[:, None] + np.arange(3)) % 3].T
        across = mesh.faces[pair[:, 1]].sum(axis=1) - start - end
        self.corners = np.stack([start, end, opposite, across], axis=1)
        self.dofs = (3 * self.corners[:, :, None] + np.arange(3)).reshape(-1, 12)
        self.rest = mesh.rest[self.corners]
        x, y = (self.rest[:, 1] - self.rest[:, 0]).T
        self.lengths = np.hypot(x, y)
        self.normals = np.stack([y, -x], axis=1) / self.lengths[:, None]
        self.areas = mesh.areas[pair].sum(axis=1)
        self.bent_areas = (mesh.areas[pair] * active[pair]).sum(axis=1)


class DihedralBending(FusedEnergy):
    """Energy e integral of tau(kappa) d theta of N hinges (Feng et al. 2022, Eq. 1 to 3), tau the
    torque of :func:`sim.material.bending_work` with the moduli (N,), N·m and N·m².

    The barrier of :mod:`sim.energies.fold_barrier` acts on theta, times ``barrier_modulus``, N·m,
    and e²/(A0 + A1) with the rest areas A of both triangles.
    """

    def __init__(
        self, hinges: Hinges, *, alpha: np.ndarray, beta: np.ndarray, barrier_modulus: float
    ) -> None:
        self.dofs = hinges.dofs
        self._alpha, self._beta = alpha, beta
        self._areas, self._lengths = hinges.bent_areas, hinges.lengths
        # kappa = spread * |theta|, 1/m per rad; e H / 2 is the area
        self._spread = self._lengths / self._areas
        self._barrier = barrier_modulus * self._lengths**2 / hinges.areas

    def _add_forces(self, q: StateVector, targets: np.ndarray, forces: np.ndarray) -> float:
        value, slope, _ = self._of_angles(q)
        add_elements(forces, targets, slope[:, None] * _angle_derivatives(
            q, self.dofs, slope, np.empty((0, 12, 12))))
        return float(value.sum())

    def hessian(self, q: StateVector, convex: bool = False) -> np.ndarray:
        # Torque and barrier increase with the angle: only its second derivatives are indefinite.
        _, slope, bend = self._of_angles(q)
        bends = np.zeros((0 if convex else len(slope), 12, 12))
        rows = _angle_derivatives(q, self.dofs, slope, bends)
        blocks = np.einsum("n,ni,nj->nij", bend, rows, rows)
        return blocks if convex else blocks + bends

    def allows(self, old: StateVector, new: StateVector) -> bool:
        """False if a hinge folds through itself, or covers most of the distance to it."""
        return _keep_distance(hinge_angles(old, self.dofs), hinge_angles(new, self.dofs))

    def _of_angles(self, q: StateVector) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(N,) energies, J, and their first two derivatives by the dihedral angles."""
        angle = hinge_angles(q, self.dofs)
        work, torque, tangent = bending_work(self._spread * np.abs(angle), self._alpha, self._beta)
        value, slope, bend = _barrier(angle)
        return (self._areas * work + self._barrier * value,
                self._lengths * np.sign(angle) * torque + self._barrier * slope,
                self._lengths * self._spread * tangent + self._barrier * bend)


@numba.njit(cache=True)
def _barrier(angles):
    result = np.empty((3, len(angles)))
    for t in range(len(angles)):
        result[:, t] = barrier_at(angles[t], np.pi)
    return result


@numba.njit(cache=True)
def _keep_distance(before, after):
    for t in range(len(before)):
        if not keeps_distance(before[t], after[t], np.pi):
            return False
    return True


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


FORMS = ("hinge", "hinge_linear")
WEIGHTINGS = ("mean", "edge")


@dataclass(frozen=True)
class HingeLaw:
    """A hinge law. The modulus along the curvature of an earlier solution (section 4.4) is omitted:
    its torque does not derive from an energy."""

    form: str = "hinge"  # alpha kappa + beta kappa²; hinge_linear: beta = 0
    direction: str = "mean"  # modulus over all directions, or across the edge (Wang et al. 2011)

    def __call__(self, mesh: Mesh, active: FaceMask, *, fabric: Fabric) -> Energy:
        hinges = Hinges(mesh, active)
        x, y = hinges.normals.T
        alpha, beta = (
            np.full(len(x), mean_modulus(moduli)) if self.direction == "mean"
            else modulus_along(moduli, np.arctan2(y, x)) for moduli in (fabric.alpha, fabric.beta))
        return DihedralBending(hinges, alpha=alpha, beta=beta * (self.form == "hinge"),
                               barrier_modulus=fabric.alpha.min())


HINGE_LAWS = {form if direction == "mean" else f"{form}_{direction}": HingeLaw(form, direction)
              for form in FORMS for direction in WEIGHTINGS}
"""hinge, hinge_edge, hinge_linear, hinge_linear_edge."""


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
