"""The laws of :mod:`sim.energies` for a batch, in PyTorch: densities, stresses and tangents.

Arrays end with the elements T and the drapes B, constants of a fabric are (B,): element-wise work
reads memory in its order. The formulas and their reasons are those of the modules named.
"""

import torch
from torch import Tensor

from sim.energies.bending_law import PlateConstants, Variant
from sim.energies.fold_barrier import LIMIT_START, MIN_REMAINING
from sim.energies.membrane import _TOLERANCE as EQUAL
from sim.material import SOFTENING_LIMIT

_SWEEPS = 5  # of Jacobi rotations: 3 x 3 matrices need four


def plate(
    s: Tensor, law: PlateConstants, variant: Variant | None = None, origin: Tensor | float = 0.0
) -> tuple[Tensor, Tensor, Tensor]:
    """Density (T, B), stress (3, T, B) and tangent (3, 3, T, B) at curvatures (3, T, B): see
    :mod:`sim.energies.bending_law`; with a ``variant``, natural curvature and friction from the
    ``origin`` (3, T, B)."""
    x, y, z = s
    none = torch.zeros_like(law.A11)
    form = _square([law.A11, law.A22, 4 * law.A66], law.A12)[:, :, None]  # (3, 3, 1, B)
    da = 2 * torch.stack([law.A11 * x + law.A12 * y, law.A22 * y + law.A12 * x, 4 * law.A66 * z])
    a = 0.5 * (da * s).sum(0)
    bent = a > 0
    n = torch.where(bent, a, 1.0).sqrt()
    weight = torch.stack([2 * law.g_w, 2 * law.g_f, 4 * law.g_t])[:, None]
    u = 0.5 * (weight * s * s).sum(0) / n
    shape, slope, bend = _shape(u)
    dn = 0.5 * da / n
    du = (weight * s - u * dn) / n
    mixed = du[:, None] * dn
    ddu = u * (dn[:, None] * dn - form) / n - mixed - mixed.transpose(0, 1)
    ddu = (ddu + _square(list(weight), none)) / n
    mixed = da[:, None] * du
    tangent = shape * form + 0.5 * (slope * (mixed + mixed.transpose(0, 1))
                                    + a * (bend * du[:, None] * du + slope * ddu))
    tangent = torch.where(bent, tangent, form)
    stress = torch.where(bent, 0.5 * (shape * da + a * slope * du), 0.0)
    work, force, stiff = _correction(2 * z.abs(), law.alpha_bias, law.base_b, law.rho_b)
    density = torch.where(bent, 0.5 * a * shape, 0.0) + work
    stress[2] += 2 * force * z.sign()
    tangent[2, 2] += 4 * stiff
    density = density + _add_yarns(x, y, law, stress, tangent)
    if variant is not None:
        moment = torch.stack([variant.m_xx, variant.m_yy, variant.m_xy])[:, None]
        density = density - (moment * s).sum(0)
        stress -= moment
        for change, share in ((s - origin, variant.slid), (s, -variant.returned)):
            if share.any():
                density = density + _add_friction(change, share, variant, stress, tangent)
    return density, stress, tangent


def _square(diagonal: list[Tensor], mixed: Tensor) -> Tensor:
    """(3, 3, ...) with the ``diagonal`` and the entry ``mixed`` of its first two rows."""
    none = torch.zeros_like(diagonal[0])
    x, y, z = diagonal
    mixed = mixed.expand_as(none)
    return torch.stack([torch.stack(row) for row in (
        [x, mixed, none], [mixed, y, none], [none, none, z])])


def _shape(u: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """:func:`sim.material.softening_shape`."""
    over = u.clamp(min=SOFTENING_LIMIT)
    beyond = over - SOFTENING_LIMIT
    share = beyond / over
    return (1 - 2 / 3 * (u - share * share * beyond),
            -2 / 3 * (1 - share * share * (3 - 2 * share)), 4 * share * (1 - share) ** 2 / over)


def _correction(k: Tensor, alpha: Tensor, base: Tensor, rho: Tensor) -> tuple[Tensor, ...]:
    fast, fast1, _ = _shape(base * k)
    slow, slow1, _ = _shape(rho * k)
    limited = ((rate * k).clamp(max=SOFTENING_LIMIT) for rate in (base, rho))
    return (0.5 * alpha * k * k * (slow - fast),
            alpha * k * (slow - fast + 0.5 * k * (rho * slow1 - base * fast1)),
            2 * alpha * (next(limited) - next(limited)))


def _add_yarns(
    x: Tensor, y: Tensor, law: PlateConstants, stress: Tensor, tangent: Tensor
) -> Tensor:
    d, side = (x - y).abs(), (x - y).sign()
    f_w, force_w, stiff_w = _correction(d, law.A11, law.base_w, law.rho_w)
    f_f, force_f, stiff_f = _correction(d, law.A22, law.base_f, law.rho_f)
    more, pull = f_w - f_f, side * (force_w - force_f)
    warp, weft = law.A11 * x * x, law.A22 * y * y
    n = warp + weft
    n = torch.where(n > 0, n, 1.0)
    w = warp / n
    wx, wy = 2 * law.A11 * x * weft / n**2, -2 * law.A22 * y * warp / n**2
    wxx = 2 * law.A11 * weft / n**2 * (1 - 4 * w)
    wyy = -2 * law.A22 * warp / n**2 * (4 * w - 3)
    wxy = 4 * law.A11 * law.A22 * x * y / n**2 * (2 * w - 1)
    force, stiff = side * force_f + w * pull, stiff_f + w * (stiff_w - stiff_f)
    stress[0] += force + wx * more
    stress[1] += wy * more - force
    tangent[0, 0] += stiff + 2 * wx * pull + wxx * more
    tangent[1, 1] += stiff - 2 * wy * pull + wyy * more
    mixed = (wy - wx) * pull + wxy * more - stiff
    tangent[0, 1] += mixed
    tangent[1, 0] += mixed
    return f_f + w * more


def _add_friction(
    change: Tensor, share: Tensor, variant: Variant, stress: Tensor, tangent: Tensor
) -> Tensor:
    limit = variant.limit
    form = _square([variant.p_xx, variant.p_yy, variant.p_xy], variant.p_mixed)[:, :, None] / limit
    pull = (form * change).sum(1)
    ratio = ((pull * change).sum(0) / limit).clamp(min=0).sqrt()
    stuck = ratio < 1
    over = torch.where(stuck, 1.25 - 0.25 * ratio**4, 1 / ratio)
    bend = torch.where(stuck, -(ratio**2), -1 / ratio**3)
    work = torch.where(stuck, 0.625 * ratio**2 - ratio**6 / 24, 0.625 - 1 / 24 + ratio - 1)
    tangent += share * (over * form + bend * pull[:, None] * pull / limit)
    stress += share * over * pull
    return share * limit * work


def slid_origin(s: Tensor, origin: Tensor, variant: Variant) -> Tensor:
    """S1 (3, T, B) after the curvatures s; see :mod:`sim.energies.bending_variants`."""
    change = s - origin
    form = _square([variant.p_xx, variant.p_yy, variant.p_xy], variant.p_mixed)[:, :, None]
    size = (form * change * change[:, None]).sum((0, 1)).clamp(min=1e-300).sqrt()
    kept = (variant.limit / size).clamp(max=1.0)
    return torch.where(variant.slid > 0, s - kept * change, origin)


def membrane(e: Tensor, diagonal: Tensor, mixed: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Density, stress and tangent of the corotational membrane at Green strains (3, T, B), with the
    matrix [[diagonal, mixed], [mixed, diagonal]], N/m, of the stretches less 1: see
    :mod:`sim.energies.membrane`."""
    total, across, shear = e[0] + e[1], e[0] - e[1], e[2]
    apart = torch.hypot(across, shear)
    a, b = ((1 + total + sign * apart).clamp(min=1e-24).sqrt() for sign in (1, -1))
    safe = torch.where(apart > 0, apart, 1.0)
    cosine, sine = torch.where(apart > 0, across / safe, 1.0), shear / safe
    p, r = diagonal * (a - 1) + mixed * (b - 1), mixed * (a - 1) + diagonal * (b - 1)
    density = 0.5 * (p * (a - 1) + r * (b - 1))
    mean, half = (p / a + r / b) / 2, (p / a - r / b) / 2
    stress = torch.stack([mean + half * cosine, mean - half * cosine, half * sine])
    axes = 0.5 * torch.stack([torch.stack(row) for row in (
        [1 + cosine, 1 - cosine, sine], [1 - cosine, 1 + cosine, -sine], [-sine, sine, cosine])])
    apart = a - b
    distinct = apart > EQUAL
    slope = torch.where(distinct, (p - r) / torch.where(distinct, apart, 1.0), diagonal - mixed)
    turning = 4 * (slope * b - r) / (a * b * (a + b))
    one, two = (diagonal - p / a) / (a * a), (diagonal - r / b) / (b * b)
    first, second, turn = axes
    cross = first[:, None] * second
    tangent = (one * first[:, None] * first + two * second[:, None] * second
               + mixed / (a * b) * (cross + cross.transpose(0, 1))
               + turning * turn[:, None] * turn)
    return density, stress, tangent


def tension(stress: Tensor) -> Tensor:
    """Stresses (3, T, B) with the negative eigenvalues of their tensors set to zero."""
    mean, half = (stress[0] + stress[1]) / 2, (stress[0] - stress[1]) / 2
    radius = torch.hypot(half, stress[2])
    low, high = (mean - radius).clamp(min=0), (mean + radius).clamp(min=0)
    turn = (high - low) / torch.where(radius > 0, 2 * radius, 1.0)
    mean = (high + low) / 2
    return torch.stack([mean + turn * half, mean - turn * half, turn * stress[2]])


def raise_eigenvalues(matrix: Tensor, floor: Tensor, share: Tensor) -> None:
    """Raise eigenvalues of symmetric matrices (3, 3, T, B) to at least ``floor`` (B,), in place;
    a ``share`` (B,) of the change is added. Most need none, as their pivots show."""
    first = matrix[0, 0] - floor
    second = (matrix[1, 1] - floor) * first - matrix[0, 1] ** 2
    cross = matrix[1, 2] * first - matrix[0, 1] * matrix[0, 2]
    third = ((matrix[2, 2] - floor) * first - matrix[0, 2] ** 2) * second - cross * cross
    sound = (first > 0) & (second > 0) & (third > 0)
    places = torch.nonzero((~sound & (share > 0)).ravel())[:, 0]
    if not len(places):
        return
    drape = places % matrix.shape[-1]
    flat = matrix.view(3, 3, -1)
    values, vectors = _eigen(flat[:, :, places])
    lift = (floor[drape] - values).clamp(min=0) * share[drape]
    flat[:, :, places] += (vectors[:, None] * vectors[None] * lift).sum(2)


def _eigen(matrix: Tensor) -> tuple[Tensor, Tensor]:
    """Eigenvalues (3, M) and, as columns, eigenvectors (3, 3, M) of matrices (3, 3, M), by cyclic
    Jacobi rotations: libraries treat so many small matrices slowly."""
    a = [[matrix[i, j].clone() for j in range(3)] for i in range(3)]
    v = list(torch.eye(3, dtype=matrix.dtype, device=matrix.device)[..., None].expand_as(matrix)
             .unbind(1))
    for _ in range(_SWEEPS):
        for p, q, r in ((0, 1, 2), (0, 2, 1), (1, 2, 0)):
            apart, mixed = a[q][q] - a[p][p], a[p][q]
            root = torch.hypot(apart, 2 * mixed).clamp(min=1e-300)
            t = 2 * mixed * torch.where(apart >= 0, 1.0, -1.0) / (apart.abs() + root)
            c = (1 + t * t).rsqrt()
            s = t * c
            a[p][p], a[q][q] = a[p][p] - t * mixed, a[q][q] + t * mixed
            a[p][q] = a[q][p] = torch.zeros_like(mixed)
            one, other = c * a[r][p] - s * a[r][q], s * a[r][p] + c * a[r][q]
            a[r][p] = a[p][r] = one
            a[r][q] = a[q][r] = other
            v[p], v[q] = c * v[p] - s * v[q], s * v[p] + c * v[q]
    return torch.stack([a[k][k] for k in range(3)]), torch.stack(v, 1)


def barrier(angle: Tensor, pole: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """The barrier of :mod:`sim.energies.fold_barrier` and two derivatives, per unit of scale."""
    size = angle.abs()
    over = size - LIMIT_START * pole
    bent = over > 0
    remaining = torch.where(bent, pole - size, 1.0)
    log = (remaining / ((1 - LIMIT_START) * pole)).log()
    terms = (-over * over * log, angle.sign() * (over * over / remaining - 2 * over * log),
             4 * over / remaining + (over / remaining) ** 2 - 2 * log)
    return tuple(torch.where(bent, term, 0.0) for term in terms)


def keeps_distance(before: Tensor, after: Tensor, pole: Tensor) -> Tensor:
    """Whether steps keep their angles (3, T, B) from the poles, for each drape (B,)."""
    turn = (after - before + torch.pi) % (2 * torch.pi) - torch.pi
    reached = (before + turn).abs()
    near = torch.minimum(pole - before.abs(), (1 - LIMIT_START) * pole)
    return (~(reached > LIMIT_START * pole) | (pole - reached >= MIN_REMAINING * near)).all(
        1).all(0)
