"""The energies of a drape in plain PyTorch, values only, with which the fast kernels of
:mod:`sim.energies` are compared.

Positions x are (V, 3) m, edge normals n (E, 3) (:mod:`sim.solver.state`), rest points (V, 2) m; N
of the triangles are free.
"""

import numpy as np
import torch
from torch import Tensor

from sim.cloth import Cloth
from sim.energies.bending_law import PlateConstants, constants
from sim.energies.external import DEPTH
from sim.energies.fold_barrier import LIMIT_START
from sim.energies.midedge import CLAMP, rows_at_clamp
from sim.rig import RIM


def moved(edges: Tensor, x: Tensor, n: Tensor, move: Tensor, turn: Tensor) -> Tensor:
    """Normals (E, 3) after displacements (V, 3), m, and turns (E,), rad; see
    :mod:`sim.solver.state`."""
    ends = (y[edges] for y in (x, x + move))
    before, after = (torch.nn.functional.normalize(y[:, 1] - y[:, 0], dim=1) for y in ends)
    scale = (n * after).sum(-1) / (1 + (before * after).sum(-1))
    along = n - scale[:, None] * (before + after)
    turn = turn[:, None]
    return torch.cos(turn) * along + torch.sin(turn) * torch.linalg.cross(after, along)


class ReferenceEnergy:
    """The energy of a cloth with the default laws.

    Attributes:
        edges: (E, 2).
        law: constants of the plate law.
        softest: smallest alpha, N·m.
        mu, lam: N/m, Lamé's constants of the corotational membrane.
        weight: N/m², of the cloth.
        pressure: N/m², of the obstacle at a depth of 0.1 mm.
        plate_radius: m; 0 without a plate.
    """

    def __init__(self, cloth: Cloth) -> None:
        scene, mesh, membrane = cloth.scene, cloth.scene.mesh, cloth.laws.membrane
        active = scene.active
        clamped = scene.held_edges[mesh.face_edges[active]]
        first, second = rows_at_clamp(mesh, active, clamped)
        boundary = mesh.edge_faces[mesh.face_edges[active], 1] < 0
        self._faces, self._face_edges, self._all_faces, self._all_face_edges, self.edges = map(
            torch.from_numpy, (mesh.faces[active], mesh.face_edges[active], mesh.faces,
                               mesh.face_edges, mesh.edges))
        # Edges of held triangles and boundary edges (N, 3), rows at a clamp (N,), free vertices
        number = np.full(len(mesh.faces), -1)
        number[active] = np.arange(active.sum())
        beside = np.where(mesh.edge_faces >= 0, number[mesh.edge_faces], -1)
        self._pairs = torch.from_numpy(beside[(beside >= 0).all(1)])  # (M, 2)
        self._clamped, self._boundary, self._first, self._second, self._free = map(
            torch.from_numpy, (clamped, boundary, first, second, ~scene.held))
        self.law, self.softest = constants(cloth.fabric), float(cloth.fabric.alpha.min())
        self.mu, self.lam = membrane.mu, membrane.lam
        self.weight = cloth.fabric.density * scene.gravity
        self.pressure = scene.contact_pressure * self.weight
        self.plate_radius = scene.obstacles[0].radius if scene.obstacles else 0.0

    def energy(self, x: Tensor, n: Tensor, rest: Tensor) -> Tensor:
        """() J, total energy."""
        return self.internal(x, n, rest) + self.external(x, rest)

    def internal(self, x: Tensor, n: Tensor, rest: Tensor) -> Tensor:
        """() J of membrane, bending and the barrier against folding."""
        corners, at_rest = x[self._faces], rest[self._faces]
        opposite = at_rest.roll(-2, 1) - at_rest.roll(-1, 1)  # edge opposite each corner
        areas, lengths = _areas(at_rest), opposite.norm(dim=-1)
        across = torch.stack([-opposite[..., 1], opposite[..., 0]], -1)
        shapes = across / (2 * areas)[:, None, None]  # whose sum with the corners is F
        membrane = self.membrane_density((corners[..., None] * shapes[:, :, None]).sum(1))
        angles = edge_angles(corners, n[self._face_edges])
        heights = 2 * areas[:, None] / lengths
        nx, ny = (across / lengths[..., None]).unbind(-1)
        rows = torch.stack([nx**2, ny**2, nx * ny], dim=1)
        weights = self._clamp_weights(areas)
        curvatures = weights[:, None] * (rows * (2 * angles / heights)[:, None]).sum(-1)
        barrier = (self.softest * lengths / heights * self._fold_barrier(angles)).sum(-1)
        plate = areas / weights
        return (areas * membrane + plate * plate_density(curvatures, self.law) + barrier
                ).sum() + self._jumps(curvatures, plate)

    def external(self, x: Tensor, rest: Tensor) -> Tensor:
        """() J of weight and contact with the cylinder."""
        areas = _areas(rest[self._all_faces])
        at_vertices = _gathered(areas / 3, self._all_faces, len(rest))
        total = (self.weight * at_vertices * x[:, 2]).sum()
        if self.plate_radius == 0:
            return total
        # At the vertices and at the midpoints of the edges, with a quarter of their areas each
        at_edges = _gathered(areas, self._all_face_edges, len(self.edges))
        free = self._free[self.edges].any(1)
        for points, shares in ((x, at_vertices * self._free), (x[self.edges].mean(1),
                                                               at_edges * free)):
            scale = self.pressure / (3 * (DEPTH * self.plate_radius) ** 2) / 4 * shares
            total = total + (scale * _depths(points, self.plate_radius) ** 3).sum()
        return total

    def membrane_density(self, gradients: Tensor) -> Tensor:
        """(N,) J/m² of the isotropic corotational membrane at deformation gradients (N, 3, 2).

        mu ((s1-1)² + (s2-1)²) + lambda/2 (s1+s2-2)² of the singular values of F, computed from its
        invariants as (mu (s1-s2)² + (mu + lambda) (s1+s2-2)²)/2.
        """
        u, v = gradients.unbind(-1)
        uu, vv, uv = (u * u).sum(-1), (v * v).sum(-1), (u * v).sum(-1)
        determinant = torch.linalg.cross(u, v).norm(dim=-1)  # s1 s2
        total = (uu + vv + 2 * determinant).sqrt()  # s1 + s2
        # (s1 - s2)² in this form: small strains are lost in the rounding of s1² + s2².
        difference = ((uu - vv) ** 2 + 4 * uv**2) / total**2
        return 0.5 * (self.mu * difference + (self.mu + self.lam) * (total - 2) ** 2)

    def _jumps(self, curvatures: Tensor, areas: Tensor) -> Tensor:
        """() J of the jumps of curvature at inner edges."""
        x, y, twist = (curvatures[self._pairs[:, 0]] - curvatures[self._pairs[:, 1]]).unbind(-1)
        law = self.law
        form = (law.A11 * x**2 + law.A22 * y**2 + 2 * law.A12 * x * y + 4 * law.A66 * twist**2)
        return (areas[self._pairs].sum(1) / 24 * form).sum()

    def _fold_barrier(self, angles: Tensor) -> Tensor:
        """(N, 3) the barrier of :mod:`sim.energies.fold_barrier` per unit of its scale."""
        pole = torch.pi / 2 * (1.0 + self._clamped.to(angles))
        bent = (angles.abs() > LIMIT_START * pole) & ~self._boundary
        angle = torch.where(bent, angles.abs(), 0.9 * pole)  # finite derivatives
        over, remaining = angle - LIMIT_START * pole, pole - angle
        barrier = -(over**2) * torch.log(remaining / ((1 - LIMIT_START) * pole))
        return torch.where(bent, barrier, 0.0)

    def _clamp_weights(self, areas: Tensor) -> Tensor:
        """Weights (N,) of :func:`sim.energies.midedge.clamp_weights`."""
        weights = torch.ones_like(areas)
        if not (self._first.any() and self._second.any()):
            return weights
        near, behind = ((areas * row).sum() for row in (self._first, self._second))
        shifted = (1 - 1 / CLAMP) * near / behind
        weights = torch.where(self._first, CLAMP, weights)
        return torch.where(self._second, 1 / (1 + shifted), weights)


def edge_angles(corners: Tensor, normals: Tensor) -> Tensor:
    """Angles phi (N, 3), rad, from a triangle's normal to the normals (N, 3, 3) of its edges."""
    edges = corners.roll(-2, -2) - corners.roll(-1, -2)
    normal = torch.linalg.cross(edges[:, 0], edges[:, 1])[:, None]
    outwards = torch.linalg.cross(edges, normal.expand_as(edges))
    out, up = (normals * outwards).sum(-1), (normals * normal).sum(-1)
    return torch.atan2(out, edges.norm(dim=-1) * up)


def plate_density(s: Tensor, law: PlateConstants) -> Tensor:
    """psi (N,), J/m², of curvatures (N, 3); see :mod:`sim.energies.bending_law`."""
    x, y, z = s.unbind(-1)
    xx, yy, zz = x * x, y * y, z * z
    a = law.A11 * xx + law.A22 * yy + 2 * law.A12 * x * y + 4 * law.A66 * zz
    flat = a <= 0
    root = torch.where(flat, 1.0, a).sqrt()
    u = (law.g_w * xx + law.g_f * yy + 2 * law.g_t * zz) / root
    warp, weft = law.A11 * xx, law.A22 * yy
    share = warp / torch.where(warp + weft > 0, warp + weft, 1.0)
    d = (x - y).abs()
    correction = (share * _correction(d, law.A11, law.base_w, law.rho_w, law.u_c)
                  + (1 - share) * _correction(d, law.A22, law.base_f, law.rho_f, law.u_c)
                  + _correction(2 * z.abs(), law.alpha_bias, law.base_b, law.rho_b, law.u_c))
    return torch.where(flat, 0.5 * a, 0.5 * a * _shape(u, law.u_c) + correction)


def _depths(points: Tensor, radius: float) -> Tensor:
    """(P,) depths of points (P, 3) in the cylinder, m, 0 outside."""
    rim = RIM * radius
    out = points[..., :2].norm(dim=-1) - (radius - rim)
    up = points[..., 2] + rim
    rounded = (out > 0) & (up > 0)
    corner = torch.where(rounded, out**2 + up**2, 1.0).sqrt()
    depth = rim - torch.where(rounded, corner, torch.maximum(out, up))
    return depth.clamp(min=0.0)


def _shape(u: Tensor, limit: float) -> Tensor:
    """H of :mod:`sim.energies.bending_law`."""
    soft = u <= limit
    v = 1.0 / torch.where(soft, 1.0, u)
    beyond = 1 - 2 * limit + 2 * v * (limit**2 - limit**3 / 3 * v)
    return torch.where(soft, 1 - 2 * u / 3, beyond)


def _correction(k: Tensor, alpha: float, base: float, rho: float, limit: float) -> Tensor:
    return 0.5 * alpha * k * k * (_shape(rho * k, limit) - _shape(base * k, limit))


def _areas(corners: Tensor) -> Tensor:
    """Areas (F,) of flat triangles (F, 3, 2)."""
    u, v = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    return 0.5 * (u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])


def _gathered(areas: Tensor, indices: Tensor, count: int) -> Tensor:
    """Sums (count,) of areas (F,) over the triangles at each of the ``indices`` (F, 3)."""
    return areas.new_zeros(count).index_add(0, indices.flatten(), areas.repeat_interleave(3))
