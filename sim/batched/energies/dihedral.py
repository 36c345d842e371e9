"""The dihedral angle of hinges and its first and second derivatives, over batches.

Corners, signs and formulas are those of :mod:`sim.energies.dihedral`. A hinge's corners are
(..., 4, 3, N); its two triangles are an axis of length 2.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from sim.batched.energies.base import cross, dot


def angles(x: Tensor) -> Tensor:
    """Dihedral angles (..., N), rad, of corners x (..., 4, 3, N) m, in (-pi, pi]."""
    x0, x1, x2, x3 = x.unbind(-3)
    edge, b = x1 - x0, x3 - x0
    normal = cross(edge, x2 - x0)
    sine = dot(normal, b) * dot(edge, edge).sqrt()
    return torch.atan2(-sine, dot(normal, cross(b, edge)))


@dataclass(frozen=True)
class Frames:
    """Unit vectors and sizes of the two triangles of every hinge.

    The second triangle's normal points to the other side, which makes both alike in the formulas.
    Where only the first one is asked for, the axis of length 2 has length 1.

    Attributes:
        normal: (..., 2, 3, N).
        across: (..., 2, 3, N), in the triangle from the edge to the opposite corner.
        along: (..., 3, N), of the edge.
        height: (..., 2, N) m, of the opposite corner over the edge.
        foot: (..., 2, N), of the height on the edge, 0 at x0 and 1 at x1.
        length: (..., N) m, of the edge.
    """

    normal: Tensor
    across: Tensor
    along: Tensor
    height: Tensor
    foot: Tensor
    length: Tensor


def frames(x: Tensor) -> Frames:
    """Frames of hinges with corners x (..., 4, 3, N) m, or (..., 3, 3, N) of first triangles."""
    origin = x[..., 0, :, :]
    edge = x[..., 1, :, :] - origin
    sides = x[..., 2:, :, :] - origin[..., None, :, :]
    square = dot(edge, edge)
    length = square.sqrt()
    outward = torch.stack([edge, -edge][: sides.shape[-3]], dim=-3)
    normal = cross(outward, sides)
    double_area = dot(normal, normal).sqrt()
    foot = dot(sides, edge[..., None, :, :]) / square[..., None, :]
    height = double_area / length[..., None, :]
    across = sides - foot[..., None, :] * edge[..., None, :, :]
    return Frames(
        normal=normal / double_area[..., None, :],
        across=across / height[..., None, :],
        along=edge / length[..., None, :],
        height=height,
        foot=foot,
        length=length,
    )


def gradient(f: Frames, *, second: float = 1.0) -> Tensor:
    """(..., 4, 3, N) derivatives of the angle by the corners.

    They are the sum of the turns of both triangles about the edge, that of the second one taken
    ``second`` times; (..., 3, 3, N) for frames of the first one alone.
    """
    opposite = -f.normal / f.height[..., None, :]
    if second != 1.0:
        opposite[..., 1, :, :] *= second
    end = -(f.foot[..., None, :] * opposite)
    start = -opposite - end
    return torch.cat(
        [start.sum(-3, keepdim=True), end.sum(-3, keepdim=True), opposite], dim=-3
    )


def second_factors(f: Frames, weight: Tensor) -> Tensor:
    """(..., 2, 3, 3, 3, N) W with which ``weight`` (..., N) times the second derivatives are

        H_ab = n W_abᵀ + W_ba nᵀ

    for the corners a and b of each triangle (of the first one alone where the frames are), in the
    order opposite corner, x1, x0, n its normal.
    With p = (1, -t, t - 1) and e = (0, 1, -1), t the foot, d the height, l the length, m across
    and u along the edge,

        W_ab = p_a p_b m/d² + e_a (p_b u/(d l) + e_b m/(2 l²)),

    the three dyads of :mod:`sim.energies.dihedral`.
    """
    weight, length = weight[..., None, :], f.length[..., None, :]
    share = torch.stack([torch.ones_like(f.foot), -f.foot, f.foot - 1.0], dim=-2)  # p
    m = f.across * (weight / f.height**2)[..., None, :]
    u = f.along[..., None, :, :] * (weight / (f.height * length))[..., None, :]
    tilt = f.across * (0.5 * weight / length**2)[..., None, :]
    by_share = share[..., None, :] * m[..., None, :, :]
    turn = share[..., None, :] * u[..., None, :, :]
    turn[..., 1, :, :] += tilt
    turn[..., 2, :, :] -= tilt
    factors = share[..., None, None, :] * by_share[..., None, :, :, :]
    factors[..., 1, :, :, :] += turn
    factors[..., 2, :, :, :] -= turn
    return factors


def add_dyads(block: Tensor, normal: Tensor, factors: Tensor, corners: tuple[int, ...]) -> None:
    """Add n W_abᵀ + W_ba nᵀ to the blocks of the pairs of ``corners``.

    Args:
        block: (..., G, 3, G, 3, N), added to in place.
        normal: (..., 3, N) n.
        factors: (..., 3, 3, 3, N) W.
        corners: where in the G groups of three the corners a are.
    """
    rows, columns = normal[..., :, None, :], normal[..., None, :, :]
    for a, group in enumerate(corners):
        for b, other in enumerate(corners):
            part = block[..., group, :, other, :, :]
            part.addcmul_(rows, factors[..., a, b, None, :, :])
            part.addcmul_(factors[..., b, a, :, None, :], columns)
