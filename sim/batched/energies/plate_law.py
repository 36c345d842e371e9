"""Energy per area of the orthotropic, softening plate over batches.

The law and its symbols are those of :mod:`sim.energies.plate_law`. Curvatures are (B, 3, N) Sxx,
Syy, Sxy in 1/m, the samples' constants (B, 15, 1) in the order of its ``CONSTANTS``.
"""

import torch
from torch import Tensor

from sim.energies.plate_law import CONSTANTS


class _Law:
    """Constants by name, (B, 1) each."""

    def __init__(self, law: Tensor) -> None:
        self.__dict__.update(zip(CONSTANTS, law.unbind(1), strict=True))

    def returned(self, k: Tensor, direction: str, alpha: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """F of a direction (w, f or b) and its two derivatives at k (B, N) >= 0."""
        base, rho = getattr(self, f"base_{direction}"), getattr(self, f"rho_{direction}")
        fast, fast1, _ = _shape(base * k, self.u_c)
        slow, slow1, _ = _shape(rho * k, self.u_c)
        less = slow - fast
        return (
            0.5 * alpha * k * k * less,
            alpha * k * (less + 0.5 * k * (rho * slow1 - base * fast1)),
            2.0 * alpha * (torch.minimum(base * k, self.u_c) - torch.minimum(rho * k, self.u_c)),
        )


def _shape(u: Tensor, limit: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """H, dH/du, d²H/du²."""
    s, c, d = 1.0 - 2.0 * limit, limit**2, -(limit**3) / 3.0
    v = 1.0 / torch.maximum(u, limit)
    soft = u <= limit
    return (
        torch.where(soft, 1.0 - 2.0 * u / 3.0, s + 2.0 * v * (c + d * v)),
        torch.where(soft, -2.0 / 3.0, -2.0 * v**2 * (c + 2.0 * d * v)),
        torch.where(soft, 0.0, 4.0 * v**3 * (c + 3.0 * d * v)),
    )


def energy(s: Tensor, law: Tensor) -> Tensor:
    """psi (B, N), J/m²."""
    k = _Law(law)
    x, y, z = s.unbind(1)
    xx, yy, zz = x * x, y * y, z * z
    a = k.A11 * xx + k.A22 * yy + 2.0 * k.A12 * x * y + 4.0 * k.A66 * zz
    a = a.clamp(min=0.0)
    u = (k.g_w * xx + k.g_f * yy + 2.0 * k.g_t * zz) / torch.where(a > 0, a, 1.0).sqrt()
    d, warp, weft = (x - y).abs(), k.A11 * xx, k.A22 * yy
    both = warp + weft
    f_w, _, _ = k.returned(d, "w", k.A11)
    f_f, _, _ = k.returned(d, "f", k.A22)
    yarns = (warp * f_w + weft * f_f) / torch.where(both > 0, both, 1.0)
    return 0.5 * a * _shape(u, k.u_c)[0] + k.returned(2.0 * z.abs(), "b", k.alpha_bias)[0] + yarns


def derivatives(s: Tensor, law: Tensor) -> tuple[Tensor, Tensor]:
    """First (B, 3, N) and second (B, 3, 3, N) derivatives of psi by the curvature.

    At S = 0, where u is of first order in S, only the quadratic form remains.
    """
    k = _Law(law)
    x, y, z = s.unbind(1)
    da = torch.stack(
        [2.0 * (k.A11 * x + k.A12 * y), 2.0 * (k.A22 * y + k.A12 * x), 8.0 * k.A66 * z], dim=1
    )
    half = torch.zeros_like(law[:, :9]).unflatten(1, (3, 3))  # of the second derivative of a
    half[:, 0, 0], half[:, 1, 1], half[:, 2, 2] = k.A11, k.A22, 4.0 * k.A66
    half[:, 0, 1] = half[:, 1, 0] = k.A12
    a = 0.5 * (da * s).sum(1)
    bent = a > 0
    n = torch.where(bent, a, 1.0).sqrt()[:, None]
    weight = torch.stack([2.0 * k.g_w, 2.0 * k.g_f, 4.0 * k.g_t], dim=1)
    u = 0.5 * (weight * s * s).sum(1, keepdim=True) / n
    shape, slope, bend = _shape(u, k.u_c[:, None])
    dn = 0.5 * da / n
    du = (weight * s - u * dn) / n
    first = 0.5 * (shape * da + a[:, None] * slope * du)

    # n d²u = weight - (du dnᵀ + dn duᵀ) + u (dn dnᵀ - half)/n
    pull, push = (a[:, None] * slope / n)[:, None], (u / n)[:, None]
    second = (2.0 * shape[:, None] - pull * push) * half
    second = second + (a[:, None] * bend * du)[:, :, None] * du[:, None]
    mixed = (slope * da - pull[:, 0] * dn)[:, :, None] * du[:, None]
    second = second + mixed + mixed.transpose(1, 2)
    second = second + (pull * push * dn[:, None]) * dn[:, :, None]
    torch.diagonal(second, dim1=1, dim2=2).add_((pull[:, 0] * weight).transpose(1, 2))
    second = torch.where(bent[:, None, None], 0.5 * second, half)

    _add_bias(z, k, first, second)
    _add_yarns(x, y, k, first, second)
    return first, second


def _add_bias(z: Tensor, k: _Law, first: Tensor, second: Tensor) -> None:
    """Add the derivatives of F_b(2 |Sxy|)."""
    _, force, stiffness = k.returned(2.0 * z.abs(), "b", k.alpha_bias)
    first[:, 2] += 2.0 * force * z.sign()
    second[:, 2, 2] += 4.0 * stiffness


def _add_yarns(x: Tensor, y: Tensor, k: _Law, first: Tensor, second: Tensor) -> None:
    """Add the derivatives of w F_w + (1 - w) F_f = F_f + w (F_w - F_f)."""
    d, side = (x - y).abs(), (x - y).sign()
    f_w, force_w, stiff_w = k.returned(d, "w", k.A11)
    f_f, force_f, stiff_f = k.returned(d, "f", k.A22)
    more, pull = f_w - f_f, side * (force_w - force_f)
    warp, weft = k.A11 * x * x, k.A22 * y * y
    n = warp + weft
    n = torch.where(n > 0, n, 1.0)
    w = warp / n
    by_square = 1.0 / n**2
    wx = 2.0 * k.A11 * x * weft * by_square
    wy = -2.0 * k.A22 * y * warp * by_square
    wxx = 2.0 * k.A11 * weft * by_square * (1.0 - 4.0 * w)
    wyy = -2.0 * k.A22 * warp * by_square * (4.0 * w - 3.0)
    wxy = 4.0 * k.A11 * k.A22 * x * y * by_square * (2.0 * w - 1.0)
    force = side * force_f + w * pull
    stiff = stiff_f + w * (stiff_w - stiff_f)
    first[:, 0] += force + wx * more
    first[:, 1] += wy * more - force
    second[:, 0, 0] += stiff + 2.0 * wx * pull + wxx * more
    second[:, 1, 1] += stiff - 2.0 * wy * pull + wyy * more
    mixed = (wy - wx) * pull + wxy * more - stiff
    second[:, 0, 1] += mixed
    second[:, 1, 0] += mixed
