"""The energies of the default drape once more, as plain PyTorch: values only, over batches.

The twin of the fast kernels in :mod:`sim.energies`, which tests compare with it; through automatic
differentiation also the source of derivatives that are not hot, such as those by the rest shape.

B cloths share one triangulation of V vertices, E edges and F triangles, N of them free. Positions x
are (B, V, 3) m, normals of edges n (B, E, 3) (:mod:`sim.state`), rest points (B, V, 2) m.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from sim.cloth import Cloth
from sim.energies.clamp import FIRST
from sim.energies.contact import RIM_RADIUS, Cylinder
from sim.energies.fold_barrier import LIMIT_START
from sim.energies.midedge import MidEdgeBending
from sim.energies.plate_law import PlateConstants, constants
from sim.energies.self_contact import SelfContact
from sim.membranes import Corotational
from sim.scene import Scene


class Topology:
    """What cloths on one triangulation, held alike, have in common.

    Args:
        scene: of one of them.
        device: of the tensors.

    Attributes:
        faces, face_edges: (N, 3) of the free triangles.
        all_faces, all_face_edges: (F, 3); edges: (E, 2).
        clamped, boundary, first, second: (N, 3), (N, 3), (N,), (N,) bool: edges of held triangles,
            edges of one triangle, rows of triangles next to a clamp.
        free: (V,) bool.
    """

    def __init__(self, scene: Scene, device: torch.device | str = "cpu") -> None:
        mesh, active = scene.mesh, scene.active
        clamped = scene.held_edges[mesh.face_edges[active]]
        first = clamped.any(axis=1)
        rim = np.zeros(len(mesh.rest), dtype=bool)
        rim[mesh.edges[mesh.face_edges[active][clamped]]] = True
        arrays = {
            "faces": mesh.faces[active], "face_edges": mesh.face_edges[active],
            "all_faces": mesh.faces, "all_face_edges": mesh.face_edges, "edges": mesh.edges,
            "clamped": clamped, "first": first, "free": ~scene.held,
            "second": rim[mesh.faces[active]].any(axis=1) & ~first,
            "boundary": mesh.edge_faces[mesh.face_edges[active], 1] < 0,
        }
        self.vertices, self.device = len(mesh.rest), torch.device(device)
        self.has_clamp = bool(first.any() and arrays["second"].any())
        for name, array in arrays.items():
            setattr(self, name, torch.from_numpy(np.ascontiguousarray(array)).to(device))


@dataclass(frozen=True, eq=False)
class Cloths:
    """B cloths on one topology: what their energies depend on beside their states.

    Attributes:
        topology: of all.
        rest: (B, V, 2) m.
        law: constants of the plate law, (B, 1) each.
        softest: (B, 1) N·m, least alpha.
        mu, lam: (B, 1) N/m, Lamé's constants of the corotational membrane.
        weight: (B, 1) N/m², of the cloth.
        pressure: (B, 1) N/m² of obstacles on cloth 0.1 mm deep in them.
        plate_radius: m; 0 without a plate.
    """

    topology: Topology
    rest: Tensor
    law: PlateConstants
    softest: Tensor
    mu: Tensor
    lam: Tensor
    weight: Tensor
    pressure: Tensor
    plate_radius: float

    def take(self, index: Tensor) -> "Cloths":
        """The cloths ``index`` (b,) int64 alone."""
        tensors = {name: value[index] for name, value in vars(self).items()
                   if isinstance(value, Tensor)}
        return replace(self, law=PlateConstants(*(c[index] for c in self.law)), **tensors)


def covers(cloth: Cloth) -> bool:
    """Whether a cloth's energies are those of the default laws; its self-contact is left out."""
    return (type(cloth.bending) is MidEdgeBending
            and type(cloth.laws.membrane) is Corotational and not cloth.others
            and all(isinstance(energy, SelfContact) for energy in cloth.extra)
            and all(isinstance(o, Cylinder) for o in cloth.scene.obstacles))


def cloths_of(cloths: Sequence[Cloth], device: torch.device | str = "cpu") -> Cloths:
    """The twins of cloths that :func:`covers` accepts, on one topology and held alike."""
    topology = Topology(cloths[0].scene, device)

    def column(values: Iterable[float]) -> Tensor:
        return torch.tensor(list(values), dtype=torch.float64, device=device)[:, None]

    obstacles = cloths[0].scene.obstacles
    weights = [cloth.fabric.density * cloth.scene.gravity for cloth in cloths]
    laws = [constants(cloth.fabric) for cloth in cloths]
    rest = torch.from_numpy(np.stack([cloth.scene.mesh.rest for cloth in cloths]))
    return Cloths(
        topology=topology,
        rest=rest.to(device),
        law=PlateConstants(*(column(values) for values in zip(*laws, strict=True))),
        softest=column(cloth.fabric.alpha.min() for cloth in cloths),
        mu=column(cloth.laws.membrane.mu for cloth in cloths),
        lam=column(cloth.laws.membrane.lam for cloth in cloths),
        weight=column(weights),
        pressure=column(cloth.scene.contact_pressure * weight
                        for cloth, weight in zip(cloths, weights, strict=True)),
        plate_radius=obstacles[0].radius if obstacles else 0.0,
    )


def moved(topology: Topology, x: Tensor, n: Tensor, move: Tensor, turn: Tensor) -> Tensor:
    """Normals (B, E, 3) after displacements (B, V, 3) and turns (B, E); see :mod:`sim.state`."""
    ends = (y[:, topology.edges] for y in (x, x + move))
    before, after = (torch.nn.functional.normalize(y[:, :, 1] - y[:, :, 0], dim=2) for y in ends)
    lean = (n * after).sum(-1) / (1 + (before * after).sum(-1))
    along = n - lean[..., None] * (before + after)
    turn = turn[..., None]
    return torch.cos(turn) * along + torch.sin(turn) * torch.linalg.cross(after, along)


def energy(cloths: Cloths, x: Tensor, n: Tensor) -> Tensor:
    """(B,) J of all of them together."""
    topology, rest = cloths.topology, rest_shapes(cloths)
    corners = x[:, topology.faces]
    angles = edge_angles(corners, n[:, topology.face_edges])
    membrane = rest.areas * membrane_density(cloths, deformation_gradients(corners, rest))
    return (membrane + bending(cloths, rest, angles)).sum(1) + outer(cloths, x)


class RestShapes(NamedTuple):
    """What the energies of the N free triangles need of their rest shapes.

    Attributes:
        areas, bending_areas: (B, N) m².
        shapes: (B, N, 3, 2) 1/m, whose sum with the corners is F.
        maps: (B, N, 3, 3) 1/m, from angles to curvatures.
        slenderness: (B, N, 3) of each edge, e/h.
    """

    areas: Tensor
    bending_areas: Tensor
    shapes: Tensor
    maps: Tensor
    slenderness: Tensor


def rest_shapes(cloths: Cloths) -> RestShapes:
    """Of the free triangles."""
    topology = cloths.topology
    corners = cloths.rest[:, topology.faces]
    opposite = corners.roll(-2, 2) - corners.roll(-1, 2)  # edge opposite each corner
    areas = _areas(corners)
    shapes = torch.stack([-opposite[..., 1], opposite[..., 0]], -1) / (2 * areas)[..., None, None]
    lengths = opposite.norm(dim=-1)
    scale = lengths / areas[..., None]  # 2/h
    across_x, across_y = opposite[..., 1] / lengths, -opposite[..., 0] / lengths
    maps = torch.stack([across_x**2, across_y**2, across_x * across_y], dim=-2)
    return RestShapes(areas, _bending_areas(topology, areas), shapes, maps * scale[..., None, :],
                      lengths * scale / 2)


def bending(cloths: Cloths, rest: RestShapes, angles: Tensor) -> Tensor:
    """(B, N) J of triangles by their angles (B, N, 3): the plate's and the barrier's."""
    plate = plate_density((rest.maps * angles[..., None, :]).sum(-1), cloths.law)
    stiffness = cloths.softest[..., None] * rest.slenderness
    return rest.bending_areas * plate + (stiffness * fold_barrier(cloths, angles)).sum(-1)


def edge_angles(corners: Tensor, normals: Tensor) -> Tensor:
    """Angles phi (..., 3), rad, from a triangle's normal to its edges' (..., 3, 3)."""
    edges = corners.roll(-2, -2) - corners.roll(-1, -2)
    normal = torch.linalg.cross(edges[..., 0, :], edges[..., 1, :])[..., None, :]
    outwards = torch.linalg.cross(edges, normal.expand_as(edges))
    out, up = (normals * outwards).sum(-1), (normals * normal).sum(-1)
    return torch.atan2(out, edges.norm(dim=-1) * up)


def deformation_gradients(corners: Tensor, rest: RestShapes) -> Tensor:
    """(B, N, 3, 2) of triangles with corners (B, N, 3, 3)."""
    return (corners[..., :, None] * rest.shapes[..., None, :]).sum(-3)


def membrane_density(cloths: Cloths, gradients: Tensor) -> Tensor:
    """(B, N) J/m² of the isotropic corotational membrane.

    mu ((s1-1)² + (s2-1)²) + lambda/2 (s1+s2-2)² of the singular values of F, by its invariants,
    as (mu (s1-s2)² + (mu + lambda) (s1+s2-2)²)/2.
    """
    u, v = gradients.unbind(-1)
    uu, vv, uv = (u * u).sum(-1), (v * v).sum(-1), (u * v).sum(-1)
    determinant = torch.linalg.cross(u, v).norm(dim=-1)  # s1 s2
    total = (uu + vv + 2 * determinant).sqrt()  # s1 + s2
    # (s1 - s2)²; without this form, strains would drown in the rounding of s1² + s2².
    difference = ((uu - vv) ** 2 + 4 * uv**2) / total**2
    return 0.5 * (cloths.mu * difference + (cloths.mu + cloths.lam) * (total - 2) ** 2)


def plate_density(s: Tensor, law: PlateConstants) -> Tensor:
    """psi (B, N), J/m², of curvatures (B, N, 3); see :mod:`sim.energies.plate_law`."""
    x, y, z = s.unbind(-1)
    xx, yy, zz = x * x, y * y, z * z
    a = law.A11 * xx + law.A22 * yy + 2 * law.A12 * x * y + 4 * law.A66 * zz
    flat = a <= 0
    root = torch.where(flat, 1.0, a).sqrt()
    u = (law.g_w * xx + law.g_f * yy + 2 * law.g_t * zz) / root
    warp, weft = law.A11 * xx, law.A22 * yy
    share = warp / torch.where(warp + weft > 0, warp + weft, 1.0)
    d = (x - y).abs()
    returned = (share * _returned(d, law.A11, law.base_w, law.rho_w, law.u_c)
                + (1 - share) * _returned(d, law.A22, law.base_f, law.rho_f, law.u_c)
                + _returned(2 * z.abs(), law.alpha_bias, law.base_b, law.rho_b, law.u_c))
    return torch.where(flat, 0.5 * a, 0.5 * a * _shape(u, law.u_c) + returned)


def fold_barrier(cloths: Cloths, angles: Tensor) -> Tensor:
    """(B, N, 3) the barrier of :mod:`sim.energies.fold_barrier` per unit of its scale."""
    topology = cloths.topology
    pole = torch.pi / 2 * (1.0 + topology.clamped.to(angles))
    bent = (angles.abs() > LIMIT_START * pole) & ~topology.boundary
    angle = torch.where(bent, angles.abs(), 0.9 * pole)  # a safe place for derivatives
    over, left = angle - LIMIT_START * pole, pole - angle
    barrier = -(over**2) * torch.log(left / ((1 - LIMIT_START) * pole))
    return torch.where(bent, barrier, 0.0)


def outer(cloths: Cloths, x: Tensor) -> Tensor:
    """(B,) J of the weight and of contact with the cylinder."""
    topology = cloths.topology
    areas = _areas(cloths.rest[:, topology.all_faces])
    at_vertices = _gathered(areas / 3, topology.all_faces, topology.vertices)
    total = (cloths.weight * at_vertices * x[..., 2]).sum(1)
    for _, points, scale, _ in touched(cloths, x):
        total = total + pressed(cloths, points, scale).sum(1)
    return total


def touched(cloths: Cloths, x: Tensor) -> list[tuple[str, Tensor, Tensor, int]]:
    """Points that may touch the cylinder: the vertices, then the middles of the edges.

    Returns:
        Name, points (B, P, 3), scale (B, P) in J/m³ and number of vertices of each point; the
        scale is zero where all are held. Nothing without a plate.
    """
    topology = cloths.topology
    if cloths.plate_radius == 0:
        return []
    areas = _areas(cloths.rest[:, topology.all_faces])
    scale = cloths.pressure / (3 * 1e-4**2) / 4
    at_vertices = _gathered(areas / 3, topology.all_faces, topology.vertices) * topology.free
    at_edges = _gathered(areas, topology.all_face_edges, len(topology.edges))
    free = topology.free[topology.edges].any(1)
    return [("vertices", x, scale * at_vertices, 1),
            ("edges", x[:, topology.edges].mean(2), scale * at_edges * free, 2)]


def pressed(cloths: Cloths, points: Tensor, scale: Tensor) -> Tensor:
    """(B, P) J of points (B, P, 3) in the cylinder."""
    return scale * _depths(points, cloths.plate_radius) ** 3


def _depths(points: Tensor, radius: float) -> Tensor:
    """(B, P) depths of points (B, P, 3) in the cylinder, m, 0 outside."""
    out = points[..., :2].norm(dim=-1) - (radius - RIM_RADIUS)
    up = points[..., 2] + RIM_RADIUS
    rounded = (out > 0) & (up > 0)
    corner = torch.where(rounded, out**2 + up**2, 1.0).sqrt()
    depth = RIM_RADIUS - torch.where(rounded, corner, torch.maximum(out, up))
    return depth.clamp(min=0.0)


def _shape(u: Tensor, limit: Tensor) -> Tensor:
    """H of :mod:`sim.energies.plate_law`."""
    soft = u <= limit
    v = 1.0 / torch.where(soft, 1.0, u)
    beyond = 1 - 2 * limit + 2 * v * (limit**2 - limit**3 / 3 * v)
    return torch.where(soft, 1 - 2 * u / 3, beyond)


def _returned(k: Tensor, alpha: Tensor, base: Tensor, rho: Tensor, limit: Tensor) -> Tensor:
    return 0.5 * alpha * k * k * (_shape(rho * k, limit) - _shape(base * k, limit))


def _bending_areas(topology: Topology, areas: Tensor) -> Tensor:
    """Areas (B, N) with the weights of :mod:`sim.energies.clamp`."""
    if not topology.has_clamp:
        return areas
    near, behind = ((areas * row).sum(1, keepdim=True) for row in (topology.first, topology.second))
    moved_area = (1 - 1 / FIRST) * near / behind
    areas = torch.where(topology.first, FIRST * areas, areas)
    return torch.where(topology.second, areas / (1 + moved_area), areas)


def _areas(corners: Tensor) -> Tensor:
    """(B, F) of flat triangles (B, F, 3, 2)."""
    u, v = corners[..., 1, :] - corners[..., 0, :], corners[..., 2, :] - corners[..., 0, :]
    return 0.5 * (u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0])


def _gathered(areas: Tensor, places: Tensor, count: int) -> Tensor:
    """(B, count) sums of areas (B, F) at each of the ``places`` (F, 3)."""
    total = areas.new_zeros(len(areas), count)
    return total.index_add(1, places.flatten(), areas.repeat_interleave(3, dim=1))
