"""Bending by mid-edge rotations: a constant-curvature plate element with finite angles.

Every edge carries a rotation zeta that splits its dihedral angle theta between its two
triangles: phi = theta/2 + zeta on one, theta/2 - zeta on the other. A free boundary edge has
phi = zeta alone, which makes the free edge exact; the edge between held and free cloth has
phi = theta on its free side, which makes the clamp exact. In a triangle the shape operator is

    S = sum_i (2 phi_i / h_i) n_i n_i^T

with h_i the rest height over edge i and n_i that edge's rest normal, and the energy is A psi(S).
For small angles this is the Morley plate element; unlike hinge energies it converges to the
plate it discretises, on any triangulation (docs/physics.md).
"""

import copy

import numba
import numpy as np

from sim.energies import dihedral, plate_law
from sim.energies.clamp import bending_areas
from sim.energies.edge_frames import EdgeFrames
from sim.energies.remember import Remembered
from sim.material import Fabric
from sim.mesh import Mesh

CONVEX_FLOOR = 0.1  # least tangent stiffness of the convex Hessian, relative to that at rest


class MidEdgeBending:
    """Plate energy of the free triangles.

    One element is a triangle with the 21 unknowns: its corners, the corners across its edges
    (18 coordinates), and the rotations of its edges.

    Args:
        mesh: the specimen, material axes warp = x, weft = y.
        active: (F,) bool, triangles that store energy (those not entirely held).
        fabric: moduli; see :mod:`sim.energies.plate_law` for the law they enter.

    Attributes:
        share, sign: (N, 3), see :func:`split_of_angles`.
        maps: (N, 3, 3), 1/m, see :func:`curvature_maps`.
        areas: (N,) m², with the weights next to a clamp.
        law: (15,) constants, see :func:`sim.energies.plate_law.constants`.
        frames, framed_dofs: see :class:`sim.energies.base.FramedEnergy`.
    """

    def __init__(self, mesh: Mesh, active: np.ndarray, *, fabric: Fabric) -> None:
        corners = np.concatenate([mesh.faces, mesh.neighbours], axis=1)[active]
        edges = mesh.face_edges[active]
        coordinates = np.where(
            corners[:, :, None] >= 0, 3 * corners[:, :, None] + np.arange(3), -1
        ).reshape(-1, 18)
        rotation = 3 * len(mesh.rest) + edges
        self.share, self.sign = split_of_angles(mesh, active)
        self.dofs = np.concatenate(
            [coordinates, np.where(self.sign != 0, rotation, -1)], axis=1
        )
        self.framed_dofs = np.concatenate([self.dofs[:, :9], self.dofs[:, 18:]], axis=1)
        self._edges = edges
        inner = np.nonzero((self.share == 0.5) & (self.sign > 0))
        beyond = self._hinge_dofs(*np.nonzero(self.share == 1.0))
        self.frames = EdgeFrames(
            dofs=self._hinge_dofs(*inner),
            rotations=rotation[inner],
            clamped=np.delete(beyond, [6, 7, 8], axis=1).ravel(),
        )
        self.areas = bending_areas(mesh, active, self.share)
        self.maps = curvature_maps(mesh)[active]
        self.law = plate_law.constants(fabric)
        self._curvatures = Remembered()

    def _hinge_dofs(self, triangle: np.ndarray, edge: np.ndarray) -> np.ndarray:
        """(M, 12) coordinates of the corners of hinges, from (M,) triangles and their edges."""
        first = np.array([_first_rows(k) for k in range(3)])[edge]  # (M, 4)
        return self.dofs[triangle[:, None], (first[:, :, None] + np.arange(3)).reshape(-1, 12)]

    def with_fabric(self, fabric: Fabric) -> "MidEdgeBending":
        """The same energy of another fabric, for a fraction of the price of a new one.

        Laws that build on this one may have more that depends on the fabric.
        """
        other = copy.copy(self)
        other.law = plate_law.constants(fabric)
        return other

    def value(self, q: np.ndarray) -> float:
        return _total(self.areas, self.density(self.curvatures(q)))

    def gradient(self, q: np.ndarray) -> np.ndarray:
        stress, _ = self.stress(self.curvatures(q))
        return _gradient(q, *self._geometry, stress)

    def hessian(self, q: np.ndarray, convexity: float) -> np.ndarray:
        return _hessian(q, *self._geometry, *self._derivatives(q, convexity), convexity)

    def framed_hessian(self, q: np.ndarray, convexity: float) -> np.ndarray:
        return _framed_hessian(q, *self._geometry, self._edges,
                               *self._derivatives(q, convexity), convexity)

    def allows(self, old: np.ndarray, new: np.ndarray) -> bool:
        return True

    def curvatures(self, q: np.ndarray) -> np.ndarray:
        """(N, 3) shape operators (Sxx, Syy, Sxy) of the active triangles, 1/m."""
        return self._curvatures.at(
            q, lambda q: _curvatures(q, self.dofs, self.share, self.sign, self.maps)
        )

    def density(self, curvatures: np.ndarray) -> np.ndarray:
        """(N,) energies, J/m², of the shape operators (N, 3)."""
        return plate_law.energies(curvatures, self.law)

    def stress(self, curvatures: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """First (N, 3) and second (N, 3, 3) derivatives of :meth:`density`."""
        return plate_law.stresses(curvatures, self.law)

    def _derivatives(self, q: np.ndarray, convexity: float) -> tuple[np.ndarray, np.ndarray]:
        """:meth:`stress` at ``q``, its tangents as convex as asked for."""
        stress, tangent = self.stress(self.curvatures(q))
        if convexity > 0.0:
            # The rotations of the edges have no other stiffness: the floor is positive.
            floor = CONVEX_FLOOR * min(self.law[0], self.law[1], 4.0 * self.law[3])
            _convexify(tangent, floor, convexity)
        return stress, tangent

    @property
    def _geometry(self) -> tuple[np.ndarray, ...]:
        return self.dofs, self.share, self.sign, self.maps, self.areas


def split_of_angles(mesh: Mesh, active: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """How the active triangles' edges share their dihedral angles.

    Returns:
        (share (N, 3), sign (N, 3)) so that phi = share * theta + sign * zeta on each edge.
    """
    faces = mesh.edge_faces[mesh.face_edges[active]]  # (N, 3, 2)
    boundary = faces[..., 1] < 0
    clamped = ~boundary & ~active[faces].all(-1)
    share = np.where(boundary, 0.0, np.where(clamped, 1.0, 0.5))
    first = faces[..., 0] == np.flatnonzero(active)[:, None]
    sign = np.where(clamped, 0.0, np.where(first, 1.0, -1.0))
    return share, sign


def curvature_maps(mesh: Mesh) -> np.ndarray:
    """(F, 3, 3) matrices, 1/m, from the angles phi of a triangle's edges to (Sxx, Syy, Sxy)."""
    corners = mesh.rest[mesh.faces]
    edge = np.roll(corners, -2, axis=1) - np.roll(corners, -1, axis=1)  # opposite corner i
    length = np.linalg.norm(edge, axis=-1)
    normal = np.stack([edge[..., 1], -edge[..., 0]], axis=-1) / length[..., None]
    scale = length / mesh.areas[:, None]  # 2/h = |e|/A
    nx, ny = normal[..., 0], normal[..., 1]
    return np.stack([nx * nx * scale, ny * ny * scale, nx * ny * scale], axis=1)


@numba.njit(cache=True)
def _first_rows(i):
    """Where the coordinates of the corners of the hinge on edge i begin in an element."""
    return 3 * ((i + 1) % 3), 3 * ((i + 2) % 3), 3 * i, 9 + 3 * i


@numba.njit(cache=True)
def _load_hinge(q, dofs, i, x):
    """Copy the corners of the hinge on edge i of an element to x (4, 3)."""
    first = _first_rows(i)
    for c in range(4):
        for k in range(3):
            x[c, k] = q[dofs[first[c] + k]]


@numba.njit(cache=True)
def _load_side(q, dofs, first, x):
    """Copy the corners of a hinge that are an element's own to x (4, 3)."""
    for c in range(3):
        for k in range(3):
            x[c, k] = q[dofs[first[c] + k]]


@numba.njit(cache=True)
def _angles(q, dofs, share, sign, x, phi):
    """Fill phi (3,) of one element; x (4, 3) is scratch."""
    for i in range(3):
        phi[i] = 0.0
        if share[i] != 0.0:
            _load_hinge(q, dofs, i, x)
            phi[i] = share[i] * dihedral.angle(x)
        if sign[i] != 0.0:
            phi[i] += sign[i] * q[dofs[18 + i]]


@numba.njit(cache=True)
def _curvatures(q, dofs, share, sign, maps):
    s = np.empty((len(dofs), 3))
    x, phi = np.empty((4, 3)), np.empty(3)
    for t in range(len(dofs)):
        _angles(q, dofs[t], share[t], sign[t], x, phi)
        for a in range(3):
            s[t, a] = maps[t, a, 0] * phi[0] + maps[t, a, 1] * phi[1] + maps[t, a, 2] * phi[2]
    return s


@numba.njit(cache=True)
def _total(areas, density):
    total = 0.0
    for t in range(len(areas)):
        total += areas[t] * density[t]
    return total


@numba.njit(cache=True)
def _gradient(q, dofs, share, sign, maps, areas, stress):
    result = np.zeros((len(dofs), 21))
    x, g, rows = np.empty((4, 3)), np.empty((4, 3)), np.empty((3, 21))
    for t in range(len(dofs)):
        _angle_rows(q, dofs[t], share[t], sign[t], x, g, rows)
        for i in range(3):
            m = 0.0
            for a in range(3):
                m += areas[t] * maps[t, a, i] * stress[t, a]
            for k in range(21):
                result[t, k] += m * rows[i, k]
    return result


@numba.njit(cache=True)
def _convexify(tangents, floor, convexity):
    """Raise eigenvalues of symmetric matrices (N, 3, 3) below ``floor`` towards it, in place."""
    for matrix in tangents:
        # Pivots of what lies above the floor: most matrices need no eigenvectors.
        first = matrix[0, 0] - floor
        second = (matrix[1, 1] - floor) * first - matrix[0, 1] ** 2
        if first > 0.0 and second > 0.0:
            cross = matrix[1, 2] * first - matrix[0, 1] * matrix[0, 2]
            if ((matrix[2, 2] - floor) * first - matrix[0, 2] ** 2) * second > cross * cross:
                continue
        value, vector = np.linalg.eigh(matrix)
        for k in range(3):
            if value[k] < floor:
                for i in range(3):
                    for j in range(3):
                        lift = convexity * (floor - value[k])
                        matrix[i, j] += lift * vector[i, k] * vector[j, k]


@numba.njit(cache=True)
def _angle_rows(q, dofs, share, sign, x, g, rows):
    """Fill rows (3, 21) with the derivatives of phi by one element's unknowns."""
    rows[:, :] = 0.0
    for i in range(3):
        rows[i, 18 + i] = sign[i]
        if share[i] != 0.0:
            _load_hinge(q, dofs, i, x)
            dihedral.gradient(x, g)
            first = _first_rows(i)
            for c in range(4):
                for k in range(3):
                    rows[i, first[c] + k] = share[i] * g[c, k]


@numba.njit(cache=True)
def _stiffness(tangent, maps, area, k):
    """Fill k (3, 3) with area maps^T tangent maps: the tangent by the angles phi."""
    for i in range(3):
        for j in range(3):
            k[i, j] = 0.0
            for a in range(3):
                for b in range(3):
                    k[i, j] += area * maps[a, i] * tangent[a, b] * maps[b, j]


@numba.njit(cache=True)
def _dyads(rows, stiffness, moment, block):
    """Fill block (K, K) with rows^T stiffness rows; rows (3, K), moment (3, K) is scratch."""
    count = len(block)
    for i in range(3):
        for j in range(count):
            moment[i, j] = (
                stiffness[i, 0] * rows[0, j]
                + stiffness[i, 1] * rows[1, j]
                + stiffness[i, 2] * rows[2, j]
            )
    for i in range(count):
        a, b, c = rows[0, i], rows[1, i], rows[2, i]
        for j in range(i, count):
            block[i, j] = a * moment[0, j] + b * moment[1, j] + c * moment[2, j]
        for j in range(i):
            block[i, j] = block[j, i]


@numba.njit(cache=True)
def _hessian(q, dofs, share, sign, maps, areas, stress, tangent, convexity):
    # d²E = K_ij dphi_i dphi_j + m_i d²phi_i: a tangent part, convex when the law is, and the
    # turning of the hinges under their torque, indefinite and dropped in full convexity.
    result = np.empty((len(dofs), 21, 21))
    x, g, frame = np.empty((4, 3)), np.empty((4, 3)), np.empty((3, 3))
    stiffness = np.empty((3, 3))
    rows, moment = np.empty((3, 21)), np.empty((3, 21))
    for t in range(len(dofs)):
        block = result[t]
        _stiffness(tangent[t], maps[t], areas[t], stiffness)
        _angle_rows(q, dofs[t], share[t], sign[t], x, g, rows)
        _dyads(rows, stiffness, moment, block)
        if convexity == 1.0:
            continue
        for i in range(3):
            if share[t, i] == 0.0:
                continue
            m = 0.0
            for a in range(3):
                m += maps[t, a, i] * stress[t, a]
            m *= areas[t] * share[t, i] * (1.0 - convexity)
            _load_hinge(q, dofs[t], i, x)
            dihedral.add_hessian(x, m, _first_rows(i), frame, block)
    return result


@numba.njit(cache=True)
def _framed_hessian(q, dofs, share, sign, maps, areas, edges, stress, tangent, convexity):
    # As in _hessian, but with the rows of phi in the edges' frames. An edge's torque is that of
    # both triangles, and each has its own part of the angle's second derivatives.
    result = np.empty((len(dofs), 12, 12))
    torque = np.zeros(edges.max() + 1)
    for t in range(len(dofs)):
        for i in range(3):
            for a in range(3):
                torque[edges[t, i]] += areas[t] * share[t, i] * maps[t, a, i] * stress[t, a]
    x, g, frame = np.empty((4, 3)), np.empty((4, 3)), np.empty((3, 3))
    stiffness = np.empty((3, 3))
    rows, moment = np.empty((3, 12)), np.empty((3, 12))
    for t in range(len(dofs)):
        block = result[t]
        _stiffness(tangent[t], maps[t], areas[t], stiffness)
        rows[:, :] = 0.0
        for i in range(3):
            rows[i, 9 + i] = sign[t, i]
            if share[t, i] != 0.0:
                first = _first_rows(i)
                _load_side(q, dofs[t], first, x)
                g[:, :] = 0.0
                dihedral.add_side_gradient(x, 2, 1.0, g)
                for c in range(3):
                    for k in range(3):
                        rows[i, first[c] + k] = g[c, k]
        _dyads(rows, stiffness, moment, block)
        if convexity == 1.0:
            continue
        for i in range(3):
            if share[t, i] != 0.0:
                first = _first_rows(i)
                _load_side(q, dofs[t], first, x)
                weight = torque[edges[t, i]] * (1.0 - convexity)
                dihedral.add_side_hessian(x, 2, 1.0, weight, first, frame, block)
    return result
