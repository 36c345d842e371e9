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
from sim.energies.base import FusedEnergy, raise_eigenvalues
from sim.material import Fabric
from sim.mesh import Mesh
from sim.solver.linear import add_block

_compiled = numba.njit(cache=True, error_model="numpy")
CONVEX_FLOOR = 0.1  # minimum tangent stiffness of the convex Hessian, relative to that at rest
CLAMP = 6 / 5
"""Stiffness of the row of triangles at clamped edges, relative to that of their area."""


class MidEdgeBending(FusedEnergy):
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
        self.origin: Curvatures = np.zeros((len(faces), 3))  # see bending_variants
        self._set_fabric(fabric)

    def _set_fabric(self, fabric: Fabric) -> None:
        """Set the attributes that depend on the fabric."""
        self.law, self.variant = bending_law.constants(fabric), bending_law.PLAIN
        self._barrier = fabric.alpha.min() * self._slenderness

    def with_fabric(self, fabric: Fabric) -> "MidEdgeBending":
        """The energy of another fabric, which shares all that depends on the mesh."""
        other = copy.copy(self)
        other._set_fabric(fabric)
        return other

    def _add_forces(self, q: StateVector, targets: np.ndarray, forces: np.ndarray) -> float:
        phi = self.angles(q)
        density, stress, _ = self.response(_curvatures(self.maps, phi))
        barrier = _add_forces(q, phi, stress, self._corners, self._sign, self.maps, self.areas,
                              self._barrier, self.pole, targets, forces)
        return float(self.areas @ density) + barrier

    def add_stiffness(
        self, q: StateVector, slots: np.ndarray, exact: np.ndarray, convex: np.ndarray
    ) -> None:
        phi = self.angles(q)
        _, stress, tangent = self.response(_curvatures(self.maps, phi))
        # Edge rotations have no other stiffness: the convex form's lower bound must be positive.
        floor = CONVEX_FLOOR * min(self.law.A11, self.law.A22, 4.0 * self.law.A66)
        _add_stiffness(q, phi, stress, np.array(tangent), self._corners, self._sign, self.maps,
                       self.areas, self._barrier, self.pole, floor, slots, exact, convex)

    def allows(self, old: StateVector, new: StateVector) -> bool:
        return _keep_distance(old, new, self._corners, self._normals, self.pole)

    def angles(self, q: StateVector) -> np.ndarray:
        """Angles phi (N, 3), rad."""
        return _angles(q, self._corners, self._normals)

    def curvatures(self, q: StateVector) -> Curvatures:
        """Shape operators of the active triangles."""
        return _curvatures(self.maps, self.angles(q))

    def response(self, curvatures: Curvatures) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Energies (N,), J/m², of the active triangles, and first (N, 3), N, and second (N, 3, 3),
        N·m, derivatives by their curvatures: all that another plate law overrides."""
        return bending_law.respond(curvatures, self.origin, self.law, self.variant)


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
def _cross(a, b):
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@numba.njit(inline="always")
def _dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@numba.njit(inline="always")
def _side(q, corners, i):
    """The vector along the edge opposite corner i, and that from its start to the corner."""
    start, end, at = corners[3 * ((i + 1) % 3)], corners[3 * ((i + 2) % 3)], corners[3 * i]
    return ((q[end] - q[start], q[end + 1] - q[start + 1], q[end + 2] - q[start + 2]),
            (q[at] - q[start], q[at + 1] - q[start + 1], q[at + 2] - q[start + 2]))


@numba.njit(inline="always")
def _inclined(q, corners, normal, i):
    """Components of the normal, at ``normal`` in q, of the edge opposite corner i: outwards from
    the triangle and up from it, times a common factor."""
    edge, arm = _side(q, corners, i)
    across, unit = _cross(edge, arm), (q[normal], q[normal + 1], q[normal + 2])
    # e × N points outwards and has |e| times the length of N.
    return _dot(unit, _cross(edge, across)), np.sqrt(_dot(edge, edge)) * _dot(unit, across)


@_compiled
def _angles(q, corners, normals):
    phi = np.empty((len(corners), 3))
    for t in range(len(corners)):
        for i in range(3):
            out, up = _inclined(q, corners[t], normals[t, i], i)
            phi[t, i] = np.arctan2(out, up)
    return phi


@_compiled
def _curvatures(maps, phi):
    s = np.empty(phi.shape)
    for t in range(len(phi)):
        for a in range(3):
            s[t, a] = (maps[t, a, 0] * phi[t, 0] + maps[t, a, 1] * phi[t, 1]
                       + maps[t, a, 2] * phi[t, 2])
    return s


@_compiled
def _keep_distance(old, new, corners, normals, pole):
    steep = np.tan(fold_barrier.LIMIT_START * np.pi / 2)
    for t in range(len(corners)):
        for i in range(3):
            out, up = _inclined(new, corners[t], normals[t, i], i)
            # Most angles are far from all poles, at most pi/2 before the step.
            if np.isinf(pole[t, i]) or (pole[t, i] < 2.0 and abs(out) < steep * up):
                continue
            after = np.arctan2(out, up)
            out, up = _inclined(old, corners[t], normals[t, i], i)
            if not fold_barrier.keeps_distance(np.arctan2(out, up), after, pole[t, i]):
                return False
    return True


@numba.njit(inline="always")
def _set_levers(q, corners, levers):
    """Fill levers (3, 3): the derivative of angle i by corner a is levers[i, a] times the unit
    normal of the triangle, which is returned."""
    edge, arm = _side(q, corners, 0)
    across = _cross(edge, arm)
    double_area = np.sqrt(_dot(across, across))
    for i in range(3):
        edge, arm = _side(q, corners, i)
        square = _dot(edge, edge)
        share = _dot(arm, edge) / square  # of the foot of the height
        slope = -np.sqrt(square) / double_area  # 1/height
        levers[i, i] = slope
        levers[i, (i + 2) % 3] = -share * slope
        levers[i, (i + 1) % 3] = (share - 1.0) * slope
    return across[0] / double_area, across[1] / double_area, across[2] / double_area


@numba.njit(inline="always")
def _moment(maps, area, stress, i):
    """Derivative of a triangle's plate energy by its angle i, J/rad."""
    return area * (maps[0, i] * stress[0] + maps[1, i] * stress[1] + maps[2, i] * stress[2])


@_compiled
def _add_forces(q, phi, stress, corners, sign, maps, areas, barrier, pole, targets, forces):
    """Energy of the barrier; forces of barrier and plate are added."""
    total, levers, moment = 0.0, np.empty((3, 3)), np.empty(3)
    for t in range(len(corners)):
        unit = _set_levers(q, corners[t], levers)
        for i in range(3):
            value, slope, _ = fold_barrier.barrier_at(phi[t, i], pole[t, i])
            total += barrier[t, i] * value
            moment[i] = barrier[t, i] * slope + _moment(maps[t], areas[t], stress[t], i)
            forces[targets[t, 9 + i]] += moment[i] * sign[t, i]
        for a in range(3):
            force = (moment[0] * levers[0, a] + moment[1] * levers[1, a]
                     + moment[2] * levers[2, a])
            for k in range(3):
                forces[targets[t, 3 * a + k]] += force * unit[k]
    return total


@_compiled
def _add_stiffness(
    q, phi, stress, tangent, corners, sign, maps, areas, barrier, pole, floor, slots, exact, convex
):
    # d²E = K_ij dphi_i dphi_j + m_i d²phi_i: a tangent term, convex if the law is, and an
    # indefinite term of the moments m, which the convex form omits.
    levers, block = np.empty((3, 3)), np.zeros((12, 12))
    fold, bends = np.empty(3), np.empty((3, 3, 3))
    for t in range(len(corners)):
        unit = _set_levers(q, corners[t], levers)
        bends[:] = 0.0
        for i in range(3):
            _, slope, bend = fold_barrier.barrier_at(phi[t, i], pole[t, i])
            fold[i] = barrier[t, i] * bend
            if len(exact):
                moment = barrier[t, i] * slope + _moment(maps[t], areas[t], stress[t], i)
                edge, arm = _side(q, corners[t], i)
                dihedral.add_side_bends(edge, arm, moment, ((i + 1) % 3, (i + 2) % 3, i), bends)
        if len(exact):
            _fill_block(unit, levers, sign[t], maps[t], areas[t], tangent[t], fold, bends, block)
            add_block(exact, slots[t], block)
        if len(convex):
            bends[:] = 0.0
            raise_eigenvalues(tangent[t], floor)
            _fill_block(unit, levers, sign[t], maps[t], areas[t], tangent[t], fold, bends, block)
            add_block(convex, slots[t], block)


@numba.njit(inline="always")
def _fill_block(unit, levers, sign, maps, area, tangent, fold, bends, block):
    """Fill the upper triangle of block (12, 12) with the second derivatives of one element."""
    stiffness, turned = np.empty((3, 3)), np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            total = fold[i] if i == j else 0.0
            for a in range(3):
                for b in range(3):
                    total += area * maps[a, i] * tangent[a, b] * maps[b, j]
            stiffness[i, j] = total
    for i in range(3):
        for a in range(3):
            turned[i, a] = (stiffness[i, 0] * levers[0, a] + stiffness[i, 1] * levers[1, a]
                            + stiffness[i, 2] * levers[2, a])
        for j in range(i, 3):
            block[9 + i, 9 + j] = stiffness[i, j] * sign[i] * sign[j]
    for a in range(3):
        for b in range(a, 3):
            half = 0.5 * (levers[0, a] * turned[0, b] + levers[1, a] * turned[1, b]
                          + levers[2, a] * turned[2, b])
            for k in range(3):
                for m in range(3):
                    block[3 * a + k, 3 * b + m] = (
                        unit[k] * (bends[a, b, m] + half * unit[m])
                        + (bends[b, a, k] + half * unit[k]) * unit[m])
        for i in range(3):
            for k in range(3):
                block[3 * a + k, 9 + i] = turned[i, a] * sign[i] * unit[k]
