"""Mid-edge bending: a constant-curvature plate element with edge normals and finite angles.

Every edge has a normal (:mod:`sim.solver.state`). In a triangle, phi is the angle about an edge
from the triangle's normal to the edge's, positive if the edge normal is inclined outwards; the
angles of the two triangles at an edge add up to its dihedral angle. The normal of a boundary edge
is free: an exact free-edge condition. An edge between held and free cloth has the normal of the
held triangle: an exact clamp. The triangle's shape operator is

    S = sum_i (2 phi_i / h_i) n_i n_i^T

with h_i the rest height over edge i and n_i that edge's rest normal, and the energy is A psi(S).
For small angles this is the Morley plate element; unlike hinge energies it converges to the
plate it discretises, on any triangulation (docs/physics.md).

Without a barrier, meshes too coarse for the cloth fold through themselves, where phi jumps. The
barrier of :mod:`sim.energies.fold_barrier` prevents that, times the smallest alpha and the edge's
rest length over the triangle's rest height; its pole is pi/2, at a clamp pi.
"""

import copy

import numba
import numpy as np

from common.types import Curvatures, FaceMask, StateVector
from sim.energies import bending_law, dihedral, fold_barrier
from sim.energies.base import Energy, StateCache, raise_eigenvalues
from sim.material import Fabric
from sim.mesh import Mesh

CONVEX_FLOOR = 0.1  # minimum tangent stiffness of the convex Hessian, relative to that at rest
CLAMP = 6 / 5
"""Stiffness of the row of triangles at clamped edges, relative to that of their area."""


class MidEdgeBending(Energy):
    """Plate energy of the active triangles, those not entirely held, with the barrier.

    One element is a triangle with 12 unknowns: the coordinates of its corners and the rotations of
    the normals of the edges opposite them. Normals between held and free cloth must be held, too.
    """

    def __init__(self, mesh: Mesh, active: FaceMask, *, fabric: Fabric) -> None:
        faces, edges = mesh.faces[active], mesh.face_edges[active]
        beyond = mesh.edge_faces[edges]  # (N, 3, 2)
        boundary = beyond[..., 1] < 0
        clamped = ~boundary & ~active[beyond].all(axis=2)
        coordinates = 3 * len(mesh.rest)
        self._normals = coordinates + 3 * edges
        self._corners = (3 * faces[:, :, None] + np.arange(3)).reshape(-1, 9)
        self.dofs = np.concatenate([self._corners, coordinates + edges], axis=1)
        # Rotations are about mesh.edges, directed from the smaller vertex index to the larger.
        forward = np.roll(faces, -1, axis=1) < np.roll(faces, -2, axis=1)
        self._sign = np.where(forward, 1.0, -1.0)
        self.areas = bending_areas(mesh, active, clamped)
        self.maps = curvature_maps(mesh)[active]
        pole = np.where(clamped, np.pi, np.pi / 2)
        self.pole = np.where(boundary, np.inf, pole)
        self._slenderness = mesh.edge_lengths[edges] ** 2 / (2 * mesh.areas[active])[:, None]  # e/h
        self._angles = StateCache()
        self._set_fabric(fabric)

    def _set_fabric(self, fabric: Fabric) -> None:
        """Set the attributes that depend on the fabric."""
        self.law = bending_law.constants(fabric)
        self._barrier = fabric.alpha.min() * self._slenderness

    def with_fabric(self, fabric: Fabric) -> "MidEdgeBending":
        """The energy of another fabric, which shares all that depends on the mesh."""
        other = copy.copy(self)
        other._set_fabric(fabric)
        return other

    def value(self, q: StateVector) -> float:
        return _total(self.areas, self.density(self.curvatures(q))) + self._fold(q)[0]

    def gradient(self, q: StateVector) -> np.ndarray:
        stress, _ = self.stress(self.curvatures(q))
        return _gradient(q, self._corners, self._sign, self._moments(q, stress))

    def hessian(self, q: StateVector, convex: bool = False) -> np.ndarray:
        stress, tangent = self.stress(self.curvatures(q))
        if convex:
            # Edge rotations have no other stiffness: the lower bound must be positive.
            law = self.law
            raise_eigenvalues(tangent, CONVEX_FLOOR * min(law.A11, law.A22, 4.0 * law.A66))
        moments = None if convex else self._moments(q, stress)
        return _hessian(q, self._corners, self._sign, self.maps, self.areas, tangent,
                        self._fold(q)[2], moments)

    def allows(self, old: StateVector, new: StateVector) -> bool:
        return fold_barrier.keeps_distance(self.angles(old), self.angles(new), self.pole)

    def angles(self, q: StateVector) -> np.ndarray:
        """Angles phi (N, 3), rad."""
        return self._angles.at(q, lambda q: _angles(q, self._corners, self._normals))

    def curvatures(self, q: StateVector) -> Curvatures:
        """Shape operators of the active triangles."""
        return _mapped(self.maps, self.angles(q))

    def density(self, curvatures: Curvatures) -> np.ndarray:
        """Energies (N,), J/m²."""
        return bending_law.energies(curvatures, self.law)

    def stress(self, curvatures: Curvatures) -> tuple[np.ndarray, np.ndarray]:
        """First (N, 3), N, and second (N, 3, 3), N·m, derivatives of :meth:`density`."""
        return bending_law.stresses(curvatures, self.law)

    def _moments(self, q: StateVector, stress: np.ndarray) -> np.ndarray:
        """Derivatives (N, 3) of the energy by the angles phi, J/rad."""
        moments = self.areas[:, None] * np.einsum("nai,na->ni", self.maps, stress)
        return moments + self._fold(q)[1]

    def _fold(self, q: StateVector) -> tuple[float, np.ndarray, np.ndarray]:
        """The barrier's energy, J, and its derivatives (N, 3) by the angles phi."""
        value, slope, bend = fold_barrier.barrier(self.angles(q), self.pole)
        return float((self._barrier * value).sum()), self._barrier * slope, self._barrier * bend


def bending_areas(mesh: Mesh, active: FaceMask, clamped: np.ndarray) -> np.ndarray:
    """Areas (N,), m², of the active triangles in the bending energy; ``clamped`` (N, 3) are their
    edges that adjoin held ones.

    Clamped cloth bends at its edges: half a hinge at the clamp, full hinges behind it, so that the
    slope far from the clamp is the trapezoidal rule's integral of the curvature. The error of that
    rule is h²/12 times the derivative of the curvature at the clamp. Gregory's weights 5/12, 13/12
    in place of 1/2, 1 cancel it. Weights of a curvature are compliances: triangles on clamped edges
    get 5/6 of theirs; those that touch the clamp with a corner keep the sum.
    """
    areas = mesh.areas[active].copy()
    first, second = rows_at_clamp(mesh, active, clamped)
    if first.any() and second.any():
        shifted = (1 - 1 / CLAMP) * areas[first].sum() / areas[second].sum()
        areas[first] *= CLAMP
        areas[second] /= 1 + shifted
    return areas


def rows_at_clamp(
    mesh: Mesh, active: FaceMask, clamped: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Masks (N,) bool of the triangles on clamped edges, and of others that touch these edges."""
    rim = np.zeros(len(mesh.rest), dtype=bool)
    rim[mesh.edges[mesh.face_edges[active][clamped]]] = True
    first = clamped.any(axis=1)
    return first, rim[mesh.faces[active]].any(axis=1) & ~first


def curvature_maps(mesh: Mesh) -> np.ndarray:
    """Matrices (F, 3, 3), 1/m, that map the angles phi of a triangle to (Sxx, Syy, Sxy)."""
    corners = mesh.rest[mesh.faces]
    edge = np.roll(corners, -2, axis=1) - np.roll(corners, -1, axis=1)  # opposite corner i
    length = np.linalg.norm(edge, axis=-1)
    normal = np.stack([edge[..., 1], -edge[..., 0]], axis=-1) / length[..., None]
    scale = length / mesh.areas[:, None]  # 2/h = |e|/A
    nx, ny = normal[..., 0], normal[..., 1]
    return np.stack([nx * nx * scale, ny * ny * scale, nx * ny * scale], axis=1)


@numba.njit(inline="always")
def _load(q, corners, i, x):
    """Copy a triangle's corners to x: start and end of the edge opposite corner i, then i."""
    for place, corner in enumerate(((i + 1) % 3, (i + 2) % 3, i)):
        for k in range(3):
            x[place, k] = q[corners[3 * corner + k]]


@numba.njit(cache=True)
def _angles(q, corners, normals):
    phi = np.empty((len(corners), 3))
    x = np.empty((3, 3))
    for t in range(len(corners)):
        for i in range(3):
            _load(q, corners[t], i, x)
            ex, ey, ez = x[1, 0] - x[0, 0], x[1, 1] - x[0, 1], x[1, 2] - x[0, 2]
            ax, ay, az = x[2, 0] - x[0, 0], x[2, 1] - x[0, 1], x[2, 2] - x[0, 2]
            nx, ny, nz = ey * az - ez * ay, ez * ax - ex * az, ex * ay - ey * ax
            # e × N points outwards and has |e| times the length of N.
            ox, oy, oz = ey * nz - ez * ny, ez * nx - ex * nz, ex * ny - ey * nx
            length = np.sqrt(ex * ex + ey * ey + ez * ez)
            at = normals[t, i]
            out = q[at] * ox + q[at + 1] * oy + q[at + 2] * oz
            up = q[at] * nx + q[at + 1] * ny + q[at + 2] * nz
            phi[t, i] = np.arctan2(out, length * up)
    return phi


@numba.njit(cache=True)
def _mapped(maps, phi):
    s = np.empty(phi.shape)
    for t in range(len(phi)):
        for a in range(3):
            s[t, a] = (maps[t, a, 0] * phi[t, 0] + maps[t, a, 1] * phi[t, 1]
                       + maps[t, a, 2] * phi[t, 2])
    return s


@numba.njit(cache=True)
def _total(areas, density):
    total = 0.0
    for t in range(len(areas)):
        total += areas[t] * density[t]
    return total


@numba.njit(cache=True)
def _angle_rows(q, corners, sign, x, g, rows):
    """Fill rows (3, 12) with the derivatives of phi by one element's unknowns."""
    rows[:, :] = 0.0
    for i in range(3):
        _load(q, corners, i, x)
        g[:, :] = 0.0
        dihedral.add_side_gradient(x, 2, 1.0, g)
        rows[i, 9 + i] = sign[i]
        for k in range(3):
            rows[i, 3 * ((i + 1) % 3) + k] = g[0, k]
            rows[i, 3 * ((i + 2) % 3) + k] = g[1, k]
            rows[i, 3 * i + k] = g[2, k]


@numba.njit(cache=True)
def _gradient(q, corners, sign, moments):
    result = np.zeros((len(corners), 12))
    x, g, rows = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 12))
    for t in range(len(corners)):
        _angle_rows(q, corners[t], sign[t], x, g, rows)
        for i in range(3):
            for k in range(12):
                result[t, k] += moments[t, i] * rows[i, k]
    return result


@numba.njit(cache=True)
def _hessian(q, corners, sign, maps, areas, tangent, fold, moments):
    # d²E = K_ij dphi_i dphi_j + m_i d²phi_i: a tangent term, convex if the law is, and an
    # indefinite term of the moments, which the convex form omits.
    result = np.empty((len(corners), 12, 12))
    x, g, frame = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    stiffness, rows, products = np.empty((3, 3)), np.empty((3, 12)), np.empty((3, 12))
    for t in range(len(corners)):
        block = result[t]
        for i in range(3):
            for j in range(3):
                stiffness[i, j] = fold[t, i] if i == j else 0.0
                for a in range(3):
                    for b in range(3):
                        stiffness[i, j] += (
                            areas[t] * maps[t, a, i] * tangent[t, a, b] * maps[t, b, j]
                        )
        _angle_rows(q, corners[t], sign[t], x, g, rows)
        for i in range(3):
            for k in range(12):
                products[i, k] = (stiffness[i, 0] * rows[0, k] + stiffness[i, 1] * rows[1, k]
                                  + stiffness[i, 2] * rows[2, k])
        for k in range(12):
            a, b, c = rows[0, k], rows[1, k], rows[2, k]
            for m in range(k, 12):
                block[k, m] = a * products[0, m] + b * products[1, m] + c * products[2, m]
            for m in range(k):
                block[k, m] = block[m, k]
        if moments is not None:
            for i in range(3):
                _load(q, corners[t], i, x)
                first = 3 * ((i + 1) % 3), 3 * ((i + 2) % 3), 3 * i
                dihedral.add_side_hessian(x, 2, 1.0, moments[t, i], first, frame, block)
    return result
