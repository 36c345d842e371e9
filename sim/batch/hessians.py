"""Hessians of the triangles of many cloths: blocks of second derivatives by steps.

The geometry by closed forms, those of :mod:`sim.energies.dihedral` and
:mod:`sim.energies.membrane`; the laws of bending, functions of a triangle's three angles, by
automatic differentiation of :mod:`sim.reference`. Of all twelve unknowns that takes eight times as
long.
"""

from collections.abc import Callable

import torch
from torch import Tensor

from sim import reference
from sim.reference import Cloths, RestShapes


def triangle_blocks(cloths: Cloths, x: Tensor, n: Tensor, convex: Tensor) -> Tensor:
    """(B, N, 12, 12) of the free triangles: by their corners, then the turns of their edges.

    Args:
        x, n: positions (B, V, 3) and normals (B, E, 3).
        convex: (B,) shares, from 0 to 1, of the membranes' compression that is left out.
    """
    topology, rest = cloths.topology, reference.rest_shapes(cloths)
    corners, normals = x[:, topology.faces], n[:, topology.face_edges]
    blocks = _bending_blocks(cloths, rest, corners, normals)
    membrane = _membrane_blocks(cloths, rest, corners, convex[:, None, None])
    blocks[..., :9, :9] += rest.areas[..., None, None] * membrane
    return blocks


def derivatives(energies: Callable[[Tensor], Tensor], at: Tensor) -> tuple[Tensor, Tensor]:
    """First (B, N, K) and second (B, N, K, K) of independent energies (B, N), each of its own K
    variables in ``at`` (B, N, K)."""
    at = at.detach().requires_grad_()
    slope, = torch.autograd.grad(energies(at).sum(), at, create_graph=True)
    units = torch.eye(at.shape[-1], dtype=at.dtype, device=at.device)
    rows, = torch.autograd.grad(slope, at, units[:, None, None].expand(-1, *at.shape),
                                is_grads_batched=True)
    return slope.detach(), rows.movedim(0, -2)


def _bending_blocks(
    cloths: Cloths, rest: RestShapes, corners: Tensor, normals: Tensor
) -> Tensor:
    """(B, N, 12, 12): K_ij dphi_i dphi_j + m_i d²phi_i.

    With n a triangle's unit normal, u along an edge of length l, m from it to the opposite corner
    at the height d, whose foot is t of the edge, and for the corners opposite, start and end
    p = (1, t - 1, -t), e = (0, -1, 1):

        dphi = -p n/d,   d²phi = (p n)(p m/d²)ᵀ + (e n)(p u/(d l) + e m/(2 l²))ᵀ, and transposed.
    """
    angles = reference.edge_angles(corners, normals)
    moments, stiffness = derivatives(lambda phi: reference.bending(cloths, rest, phi), angles)
    start = corners.roll(-1, -2)
    edge, side = corners.roll(-2, -2) - start, corners - start
    length, normal = edge.norm(dim=-1, keepdim=True), torch.linalg.cross(edge, side)
    u, foot = edge / length, (edge * side).sum(-1, keepdim=True) / length**2
    height = normal.norm(dim=-1, keepdim=True) / length
    n, m = normal / (height * length), (side - foot * edge) / height
    opposite = torch.eye(3, dtype=edge.dtype, device=edge.device)  # edges by corners
    starts, ends = opposite.roll(1, 1), opposite.roll(2, 1)
    p, e = opposite - (1 - foot) * starts - foot * ends, ends - starts

    topology = cloths.topology
    forward = topology.faces.roll(-1, 1) < topology.faces.roll(-2, 1)
    turns = torch.diag_embed(torch.where(forward, 1.0, -1.0).to(edge))
    rows = torch.cat([_spread(p, -n / height), turns.expand(len(edge), -1, -1, -1)], dim=-1)
    blocks = rows.mT @ stiffness @ rows
    left = torch.cat([_spread(p, n), _spread(e, n)], dim=-2)
    right = torch.cat([_spread(p, m / height**2),
                       _spread(p, u / (height * length)) + _spread(e, m / (2 * length**2))], dim=-2)
    half = left.mT @ (moments.repeat(1, 1, 2)[..., None] * right)
    blocks[..., :9, :9] += half + half.mT
    return blocks


def _membrane_blocks(cloths: Cloths, rest: RestShapes, corners: Tensor, convex: Tensor) -> Tensor:
    """(B, N, 9, 9) N/m per area, in the basis of the principal directions.

    The convex form takes the compression out of the stress, as
    :class:`sim.energies.membrane.StrainMembrane` does. By hand, for a singular value decomposition
    of one NaN would stop all samples.
    """
    u, v = reference.deformation_gradients(corners, rest).unbind(-1)
    half, product = 0.5 * ((u * u).sum(-1) - (v * v).sum(-1)), (u * v).sum(-1)
    angle = 0.5 * torch.atan2(product, half)[..., None]
    cosine, sine = torch.cos(angle), torch.sin(angle)
    one, other = cosine * u + sine * v, cosine * v - sine * u
    s1, s2 = one.norm(dim=-1, keepdim=True), other.norm(dim=-1, keepdim=True).clamp(min=1e-12)
    u1, u2 = one / s1, other / s2
    out = torch.linalg.cross(u1, u2)
    weight1 = cosine * rest.shapes[..., 0] + sine * rest.shapes[..., 1]  # of each corner
    weight2 = cosine * rest.shapes[..., 1] - sine * rest.shapes[..., 0]
    first, second = _spread(weight1, u2), _spread(weight2, u1)
    modes = torch.stack([_spread(weight1, u1), _spread(weight2, u2),
                         0.5**0.5 * (first + second), 0.5**0.5 * (first - second),
                         _spread(weight1, out), _spread(weight2, out)], dim=-2)
    mu, lam = cloths.mu[..., None], cloths.lam[..., None]
    p1, p2 = (2 * mu * (s - 1) + lam * (s1 + s2 - 2) for s in (s1, s2))
    turning = torch.cat([(p1 + p2) / (s1 + s2), p1 / s1, p2 / s2], dim=-1)
    stretching = (2 * mu).expand(*s1.shape[:-1], 3)
    values = torch.diag_embed(torch.cat([stretching, turning], dim=-1))
    values[..., :2, :2] += lam[..., None]
    compression = convex * (-turning[..., 1:]).clamp(min=0.0)
    weights = torch.stack([weight1, weight2], dim=-1)  # (B, N, 3, 2)
    pairs = (weights * compression[..., None, :]) @ weights.mT
    lift = pairs[..., :, None, :, None] * torch.eye(3).to(pairs)[:, None, :]
    return modes.mT @ values @ modes + lift.flatten(-4, -3).flatten(-2, -1)


def _spread(shares: Tensor, vector: Tensor) -> Tensor:
    """(..., 9) a vector (..., 3) for each of three corners, times its share (..., 3)."""
    return (shares[..., :, None] * vector[..., None, :]).flatten(-2)
