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

That element is too soft for short waves. An inner edge therefore stores the jump of curvature,

    A_e/8 (S1 - S2) : A : (S1 - S2),   A_e = (A1 + A2)/3,

in the form A of flat cloth, of curvatures less the natural ones. It vanishes for constant
curvature, and is of second order in h otherwise.

Without a barrier, meshes too coarse for the cloth fold through themselves, where phi jumps. The
barrier of :mod:`sim.energies.fold_barrier` prevents that, times the smallest alpha and the edge's
rest length over the triangle's rest height; its pole is pi/2, at a clamp pi.
"""

import copy
from typing import Any

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
"""Factor of the curvature of triangles at clamped edges (:func:`clamp_weights`)."""


class MidEdgeBending(FusedEnergy):
    """Plate energy of the active triangles, those not entirely held, with the barrier.

    The first N elements are triangles with 12 unknowns: the coordinates of their corners and the
    rotations of the normals of the edges opposite them. The other M are pairs of triangles at inner
    edges with their 17. Normals between held and free cloth must be held, too.

    Attributes:
        pairs, places: (M, 2) numbers of a pair's triangles among the N, and (M, 2, 12) the places
            of their unknowns among the pair's 17.
        signs: (N, 3) of the edges' rotations, seen from a triangle.
        areas: (N,) m², of the bending energy (:func:`clamp_weights`).
        maps: (N, 3, 3) 1/m, from angles to curvatures.
        pole: (N, 3) rad, of the barrier at each edge; infinite: none.
    """

    natural: Curvatures | float = 0.0  # of zero energy, for a variant of the law
    layers: np.ndarray | float = 1.0  # of cloth, of each triangle

    def __init__(self, mesh: Mesh, active: FaceMask, *, fabric: Fabric) -> None:
        faces, edges = mesh.faces[active], mesh.face_edges[active]
        beyond = mesh.edge_faces[edges]  # (N, 3, 2)
        boundary = beyond[..., 1] < 0
        clamped = ~boundary & ~active[beyond].all(axis=2)
        coordinates = 3 * len(mesh.rest)
        self._normals = coordinates + 3 * edges
        self._corners = (3 * faces[:, :, None] + np.arange(3)).reshape(-1, 9)
        self.pairs, self.places = _pairs(mesh, active)
        own, count = np.concatenate([self._corners, coordinates + edges], axis=1), len(faces)
        self.dofs = np.full((count + len(self.pairs), 17), -1)
        self.dofs[:count, :12] = own
        for side in (0, 1):
            rows = np.arange(count, len(self.dofs))[:, None]
            self.dofs[rows, self.places[:, side]] = own[self.pairs[:, side]]
        # Rotations are about mesh.edges, directed from the smaller vertex index to the larger.
        forward = np.roll(faces, -1, axis=1) < np.roll(faces, -2, axis=1)
        self.signs = np.where(forward, 1.0, -1.0)
        weights = clamp_weights(mesh, active, clamped)
        self.areas = mesh.areas[active] / weights
        self._jumps = self.areas[self.pairs].sum(axis=1) / 12
        self._around = np.bincount(self.pairs.ravel(), np.repeat(self._jumps, 2), count)
        self.maps = weights[:, None, None] * curvature_maps(mesh)[active]
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
        value, moments, _ = self._of_curvatures(_curvatures(self.maps, phi), tangents=False)
        return value + _add_forces(q, phi, moments, self._corners, self.signs, self.maps,
                                   self._barrier, self.pole, targets, forces)

    def add_stiffness(
        self, q: StateVector, slots: np.ndarray, exact: np.ndarray, convex: np.ndarray
    ) -> None:
        phi = self.angles(q)
        _, moments, tangent = self._of_curvatures(_curvatures(self.maps, phi), tangents=True)
        for data, is_convex in ((exact, False), (convex, True)):
            if not len(data):
                continue
            if is_convex:
                # Edge rotations have no other stiffness: their lower bound must be positive.
                raise_eigenvalues(tangent, CONVEX_FLOOR * self.form.diagonal().min())
            both = (self.areas[:, None, None] * tangent
                    + self._around[:, None, None] * self.form)
            _add_stiffness(q, phi, moments, both, self.form, self._jumps, self._corners,
                           self.signs, self.maps, self._barrier, self.pole, self.pairs,
                           self.places, slots, data, is_convex)

    def _of_curvatures(
        self, curvatures: Curvatures, *, tangents: bool
    ) -> tuple[float, np.ndarray, np.ndarray]:
        """The plate's energy, its derivatives (N, 3), N·m², by the curvatures, and the tangents
        (N, 3, 3), N·m, of :meth:`response`."""
        density, stress, tangent = self.response(curvatures, tangents)
        moments = self.areas[:, None] * stress
        jumps = _add_jumps(curvatures - self.natural, self.form, self._jumps, self.pairs, moments)
        return float(self.areas @ density) + jumps, moments, tangent

    def allows(self, old: StateVector, new: StateVector) -> bool:
        return _keep_distance(old, new, self._corners, self._normals, self.pole)

    def angles(self, q: StateVector) -> np.ndarray:
        """Angles phi (N, 3), rad."""
        return _angles(q, self._corners, self._normals)

    def curvatures(self, q: StateVector) -> Curvatures:
        """Shape operators of the active triangles."""
        return _curvatures(self.maps, self.angles(q))

    def response(
        self, curvatures: Curvatures, tangents: bool = True
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Energies (N,), J/m², of the active triangles, and first (N, 3), N, and second (N, 3, 3),
        N·m, derivatives by their curvatures, the second only with ``tangents``. Another plate law
        overrides this, and :attr:`form`."""
        return bending_law.respond(curvatures, self.origin, self.law, self.variant, tangents)

    @property
    def form(self) -> np.ndarray:
        """(3, 3) N·m, the tangent of flat cloth."""
        return bending_law.form(self.law)


def clamp_weights(mesh: Mesh, active: FaceMask, clamped: np.ndarray) -> np.ndarray:
    """Factors (N,) of the curvatures of the active triangles, whose areas in the bending energy are
    divided by them; ``clamped`` (N, 3) are their edges that adjoin held ones.

    Gregory's weights 5/12, 13/12 in place of 1/2, 1 cancel the trapezoidal rule's error at the
    clamp (docs/physics.md). Triangles on clamped edges have 5/6 of their area for that; those that
    touch the clamp with a corner keep the sum.
    """
    weights, areas = np.ones(active.sum()), mesh.areas[active]
    first, second = rows_at_clamp(mesh, active, clamped)
    if first.any() and second.any():
        weights[first] = CLAMP
        weights[second] = weight_behind(areas[first].sum(), areas[second].sum())
    return weights


def weight_behind(first: Any, second: Any) -> Any:
    """Weight of the triangles that touch the clamp with a corner, where those on its edges have
    :data:`CLAMP`; their total areas ``second`` and ``first``, m², are numbers, arrays or tensors
    (:mod:`sim.batched`) of one shape."""
    return 1 / (1 + (1 - 1 / CLAMP) * first / second)


def rows_at_clamp(
    mesh: Mesh, active: FaceMask, clamped: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Masks (N,) bool of the triangles on clamped edges, and of others that touch these edges."""
    rim = np.zeros(len(mesh.rest), dtype=bool)
    rim[mesh.edges[mesh.face_edges[active][clamped]]] = True
    first = clamped[:, 0] | clamped[:, 1] | clamped[:, 2]
    return first, rim[mesh.faces[active]].any(axis=1) & ~first


def _pairs(mesh: Mesh, active: FaceMask) -> tuple[np.ndarray, np.ndarray]:
    """Active triangles (M, 2) at the edges between two of them, as their numbers among the active
    ones, and the places (M, 2, 12) of their unknowns among the pair's 17: the coordinates of the
    edge's ends and of the corners opposite it, the rotation of the edge, and those of the others.
    """
    inner = np.flatnonzero((mesh.edge_faces[:, 1] >= 0) & active[mesh.edge_faces].all(axis=1))
    faces = mesh.edge_faces[inner]
    opposite = (mesh.face_edges[faces] == inner[:, None, None]).argmax(axis=2)
    after = (np.arange(3) - opposite[:, :, None]) % 3  # from the opposite corner on
    corners = np.array([[2, 0, 1], [3, 1, 0]])[[[[0]], [[1]]], after.swapaxes(0, 1)]
    edges = np.array([[12, 13, 14], [12, 15, 16]])[[[[0]], [[1]]], after.swapaxes(0, 1)]
    coordinates = (3 * corners[..., None] + np.arange(3)).reshape(2, -1, 9)
    places = np.concatenate([coordinates, edges], axis=2).swapaxes(0, 1)
    return np.cumsum(active)[faces] - 1, np.ascontiguousarray(places)


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
        levers[i, (i + 1) % 3], levers[i, (i + 2) % 3], levers[i, i] = dihedral.side_levers(
            edge, arm, double_area)
    return across[0] / double_area, across[1] / double_area, across[2] / double_area


@numba.njit(inline="always")
def _moment(maps, moments, i):
    """Derivative of the plate's energy by a triangle's angle i, J/rad."""
    return maps[0, i] * moments[0] + maps[1, i] * moments[1] + maps[2, i] * moments[2]


@_compiled
def _add_jumps(curvatures, form, jumps, pairs, moments):
    """Energy of the jumps of curvature; its derivatives are added to moments (N, 3)."""
    total, jump = 0.0, np.empty(3)
    for p in range(len(pairs)):
        first, second = pairs[p]
        for a in range(3):
            jump[a] = jumps[p] * (curvatures[first, a] - curvatures[second, a])
        for a in range(3):
            moment = form[a, 0] * jump[0] + form[a, 1] * jump[1] + form[a, 2] * jump[2]
            total += 0.5 * moment * (curvatures[first, a] - curvatures[second, a])
            moments[first, a] += moment
            moments[second, a] -= moment
    return total


@_compiled
def _add_forces(q, phi, moments, corners, sign, maps, barrier, pole, targets, forces):
    """Energy of the barrier; forces of barrier and plate are added."""
    total, levers, moment = 0.0, np.empty((3, 3)), np.empty(3)
    for t in range(len(corners)):
        unit = _set_levers(q, corners[t], levers)
        for i in range(3):
            value, slope, _ = fold_barrier.barrier_at(phi[t, i], pole[t, i])
            total += barrier[t, i] * value
            moment[i] = barrier[t, i] * slope + _moment(maps[t], moments[t], i)
            forces[targets[t, 9 + i]] += moment[i] * sign[t, i]
        for a in range(3):
            force = (moment[0] * levers[0, a] + moment[1] * levers[1, a]
                     + moment[2] * levers[2, a])
            for k in range(3):
                forces[targets[t, 3 * a + k]] += force * unit[k]
    return total


@_compiled
def _add_stiffness(
    q, phi, moments, tangent, form, jumps, corners, sign, maps, barrier, pole, pairs, places,
    slots, data, convex
):
    # d²E = K_ij dphi_i dphi_j + m_i d²phi_i: a tangent term, convex if the law is, and an
    # indefinite term of the moments m, which the convex form omits.
    count, levers, stiffness = len(corners), np.empty((3, 3)), np.empty((3, 3))
    # Derivatives of the angles by each corner along the normal, and by the edges' rotations
    turns, units = np.zeros((count, 3, 6)), np.empty((count, 3))
    bends, factors, block = np.zeros((3, 3, 3)), np.empty((12, 12)), np.zeros((17, 17))
    for t in range(count):
        # Element by element: an array set to another takes Numba 10 s more to compile.
        unit = _set_levers(q, corners[t], levers)
        for k in range(3):
            units[t, k] = unit[k]
        _between_angles(maps[t], tangent[t], maps[t], stiffness)
        bends[:] = 0.0
        for i in range(3):
            for k in range(3):
                turns[t, i, k] = levers[i, k]
            turns[t, i, 3 + i] = sign[t, i]
            _, slope, bend = fold_barrier.barrier_at(phi[t, i], pole[t, i])
            stiffness[i, i] += barrier[t, i] * bend
            if not convex:
                moment = barrier[t, i] * slope + _moment(maps[t], moments[t], i)
                edge, arm = _side(q, corners[t], i)
                dihedral.add_side_bends(edge, arm, moment, ((i + 1) % 3, (i + 2) % 3, i), bends)
        _fill_factors(turns[t], stiffness, turns[t], units[t], units[t], block)
        for a in range(3):
            for b in range(a, 3):
                for k in range(3):
                    for m in range(3):
                        block[3 * a + k, 3 * b + m] += (
                            units[t, k] * bends[a, b, m] + bends[b, a, k] * units[t, m])
        add_block(data, slots[t], block)
    for p in range(len(pairs)):
        one, other = pairs[p]
        _between_angles(maps[one], form, maps[other], stiffness)
        stiffness *= -jumps[p]
        _fill_factors(turns[one], stiffness, turns[other], units[one], units[other], factors)
        for i in range(12):
            u = places[p, 0, i]
            for j in range(12):
                v = places[p, 1, j]
                first = min(u, v)
                slot = slots[count + p, first * (33 - first) // 2 + max(u, v)]
                if slot >= 0:
                    data[slot] += factors[i, j] if u != v else 2.0 * factors[i, j]


@numba.njit(inline="always")
def _between_angles(left, tangent, right, stiffness):
    """Fill stiffness (3, 3) by two triangles' angles with a tangent (3, 3) by their curvatures."""
    for i in range(3):
        for j in range(3):
            total = 0.0
            for a in range(3):
                for b in range(3):
                    total += left[a, i] * tangent[a, b] * right[b, j]
            stiffness[i, j] = total


@numba.njit(inline="always")
def _fill_factors(left, stiffness, right, left_unit, right_unit, factors):
    """Fill factors, at least (12, 12), with second derivatives by the unknowns of two triangles of
    normals ``left_unit`` and ``right_unit``, of the ``stiffness`` between their angles."""
    for i in range(6):
        along = (left[0, i] * stiffness[0, 0] + left[1, i] * stiffness[1, 0]
                 + left[2, i] * stiffness[2, 0],
                 left[0, i] * stiffness[0, 1] + left[1, i] * stiffness[1, 1]
                 + left[2, i] * stiffness[2, 1],
                 left[0, i] * stiffness[0, 2] + left[1, i] * stiffness[1, 2]
                 + left[2, i] * stiffness[2, 2])
        for j in range(6):
            value = along[0] * right[0, j] + along[1] * right[1, j] + along[2] * right[2, j]
            if i < 3 and j < 3:
                for k in range(3):
                    for m in range(3):
                        factors[3 * i + k, 3 * j + m] = value * left_unit[k] * right_unit[m]
            elif i < 3:
                for k in range(3):
                    factors[3 * i + k, 6 + j] = value * left_unit[k]
            elif j < 3:
                for m in range(3):
                    factors[6 + i, 3 * j + m] = value * right_unit[m]
            else:
                factors[6 + i, 6 + j] = value
