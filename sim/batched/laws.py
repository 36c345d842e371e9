"""The laws of :mod:`sim.energies` for a batch, in PyTorch: densities, stresses and tangents.

Arrays end with the elements T and the drapes B, so that element-wise work reads memory in its
order. The formulas and their reasons are those of the modules named.
"""

import numpy as np
import torch
from torch import Tensor

from sim.energies.bending_law import PlateConstants, Variant, form
from sim.energies.fold_barrier import LIMIT_START, MIN_REMAINING
from sim.energies.membrane import EQUAL
from sim.material import SOFTENING_LIMIT as LIMIT

Response = tuple[Tensor, Tensor, Tensor]
"""Density (T, B), stress (3, T, B) and tangent (3, 3, T, B), empty if it is not wanted."""


def plate_rows(c: PlateConstants) -> dict[str, np.ndarray]:
    """Constants of a fabric's plate by name: the quadratic form a (3, 3), that of g (3,), alpha
    (3,) and the softening rates base and rho (2, 3) along warp, weft and bias."""
    rows = {"form": form(c), "soft": (2 * c.g_w, 2 * c.g_f, 4 * c.g_t),
            "alpha": (c.A11, c.A22, c.alpha_bias),
            "rates": ((c.base_w, c.base_f, c.base_b), (c.rho_w, c.rho_f, c.rho_b)),
            "softest": min(c.A11, c.A22, c.alpha_bias)}
    return {name: np.array(row) for name, row in rows.items()}


def variant_rows(variant: Variant) -> dict[str, np.ndarray]:
    """The same of friction (:mod:`sim.energies.bending_variants`): P over the limit (3, 3), and
    three numbers."""
    pull = [[variant.p_xx, variant.p_mixed, 0.0], [variant.p_mixed, variant.p_yy, 0.0],
            [0.0, 0.0, variant.p_xy]]
    rows = {"pull": np.array(pull) / variant.limit, "limit": variant.limit,
            "slid": variant.slid, "returned": variant.returned}
    return {name: np.array(row) for name, row in rows.items()}


def plate(s: Tensor, law: dict[str, Tensor], *, tangent: bool = False) -> Response:
    """The plate at curvatures (3, T, B), with the constants of :func:`plate_rows` and, if there are
    any, of :func:`variant_rows`; see :mod:`sim.energies.bending_law`."""
    form, soft, alpha = law["form"][:, :, None], law["soft"][:, None], law["alpha"][:, None]
    da = 2 * (form * s).sum(1)
    a = 0.5 * (da * s).sum(0)
    bent = a > 0
    n = torch.where(bent, a, 1.0).sqrt()
    weight = soft * s
    u = 0.5 * (weight * s).sum(0) / n
    shape, slope = _shape(u)
    du = (weight - 0.5 * u / n * da) / n
    stress = 0.5 * (shape * da + a * slope * du)
    # The corrections along warp, weft and bias
    along, twist = s[0] - s[1], 2 * s[2]
    side = torch.stack([along, along, twist])
    k, side = side.abs(), side.sign()
    rate = law["rates"][:, :, None] * k
    (fast, slow), slopes = _shape(rate)
    excess = slow - fast
    work = 0.5 * alpha * k * k * excess
    force = side * alpha * k * (excess + 0.5 * (rate[1] * slopes[1] - rate[0] * slopes[0]))
    # Between warp and weft the share w of the first
    yarn = alpha[:2] * s[:2] ** 2
    sum_of_both = yarn.sum(0)
    sum_of_both = torch.where(sum_of_both > 0, sum_of_both, 1.0)
    w = yarn[0] / sum_of_both
    more, pull = work[0] - work[1], force[0] - force[1]
    dw = 2 * alpha[:2] * s[:2] * yarn.flip(0) / sum_of_both**2
    dw[1] *= -1
    mean = force[1] + w * pull
    stress += torch.stack([mean, -mean, 2 * force[2]])
    stress[:2] += dw * more
    density = 0.5 * a * shape + work[1] + w * more + work[2]
    if not tangent:
        none = s.new_empty(0)
        return density + _variant(s, law, stress, none), stress, none
    over = u.clamp(min=LIMIT)
    bend = 4 * (1 - LIMIT / over) * (LIMIT / over) ** 2 / over
    # With u's second derivatives, all terms are products of the slopes of a and u, or forms.
    half = 0.25 * (slope * da + a * bend * du)
    stiff = (shape - 0.5 * slope * u) * form
    stiff.addcmul_(du[:, None], half).addcmul_(half[:, None], du)
    stiff.addcmul_((0.125 * slope * u / (n * n) * da)[:, None], da)
    plain = torch.where(bent, 0.5 * n * slope, 0.0) * soft
    stiff.diagonal(dim1=0, dim2=1).add_(plain.movedim(0, -1))
    limited = rate.clamp(max=LIMIT)
    along = 2 * alpha * (limited[0] - limited[1])
    mean = along[1] + w * (along[0] - along[1])
    ddw = 2 * alpha[:2] * yarn.flip(0) / sum_of_both**2 * torch.stack([1 - 4 * w, 3 - 4 * w])
    stiff[0, 0] += mean + 2 * dw[0] * pull + ddw[0] * more
    stiff[1, 1] += mean - 2 * dw[1] * pull + ddw[1] * more
    mixed = 4 * alpha[0] * alpha[1] * s[0] * s[1] / sum_of_both**2 * (2 * w - 1)
    mixed = (dw[1] - dw[0]) * pull + mixed * more - mean
    stiff[0, 1] += mixed
    stiff[1, 0] += mixed
    stiff[2, 2] += 4 * along[2]
    return density + _variant(s, law, stress, stiff), stress, stiff


def _variant(
    s: Tensor, law: dict[str, Tensor], stress: Tensor, stiff: Tensor
) -> Tensor | float:
    """Energy of natural curvature and friction; its derivatives are added."""
    if "moments" not in law:
        return 0.0
    moment, pull, limit = law["moments"], law["pull"][:, :, None], law["limit"]
    density = -(moment * s).sum(0)
    stress -= moment
    for change, share in ((s - law["origin"], law["slid"]), (s, -law["returned"])):
        force = (pull * change).sum(1)
        ratio = ((force * change).sum(0) / limit).clamp(min=0).sqrt()
        stuck = ratio < 1
        over = torch.where(stuck, 1.25 - 0.25 * ratio**4, 1 / ratio)
        work = torch.where(stuck, 0.625 * ratio**2 - ratio**6 / 24, ratio - 0.375 - 1 / 24)
        density += share * limit * work
        stress += share * over * force
        if len(stiff):
            bend = torch.where(stuck, -(ratio**2), -1 / ratio**3) / limit
            stiff += share * (over * pull + bend * force[:, None] * force)
    return density


def slid_origin(s: Tensor, law: dict[str, Tensor]) -> Tensor:
    """The origin S1 (3, T, B) after the curvatures s; see :mod:`sim.energies.bending_variants`."""
    change = s - law["origin"]
    square = (law["pull"][:, :, None] * change * change[:, None]).sum((0, 1)) / law["limit"]
    kept = square.clamp(min=1e-300).rsqrt().clamp(max=1.0)
    return torch.where(law["slid"] > 0, s - kept * change, law["origin"])


def _shape(u: Tensor) -> tuple[Tensor, Tensor]:
    """H and its slope of :func:`sim.material.softening_shape`."""
    over = u.clamp(min=LIMIT)
    beyond = over - LIMIT
    share = beyond / over
    square = share * share
    return 1 - 2 / 3 * (u - square * beyond), (square * (3 - 2 * share) - 1) * (2 / 3)


def membrane(e: Tensor, law: Tensor, *, tangent: bool = False) -> Response:
    """The membrane at Green strains (3, T, B); see :mod:`sim.energies.membrane`. Its matrix is the
    ``law``, N/m: (3, 3, B) of the strains, or, corotational, (2, 2, B) of the stretches less 1."""
    if len(law) == 3:
        stiff = law[:, :, None]
        stress = (stiff * e).sum(1)
        return 0.5 * (e * stress).sum(0), stress, stiff.expand(3, *e.shape)
    direct, mixed = law[0]
    total, across, shear = e[0] + e[1], e[0] - e[1], e[2]
    apart = torch.hypot(across, shear)
    a, b = ((1 + total + sign * apart).clamp(min=1e-24).sqrt() for sign in (1, -1))
    isotropic = apart == 0
    safe = torch.where(isotropic, 1.0, apart)
    cosine, sine = torch.where(isotropic, 1.0, across / safe), shear / safe
    p, r = direct * (a - 1) + mixed * (b - 1), mixed * (a - 1) + direct * (b - 1)
    density = 0.5 * (p * (a - 1) + r * (b - 1))
    larger, smaller = p / a, r / b
    mean, half = (larger + smaller) / 2, (larger - smaller) / 2
    stress = torch.stack([mean + half * cosine, mean - half * cosine, half * sine])
    if not tangent:
        return density, stress, e.new_empty(0)
    first, second, turn = (0.5 * torch.stack(axis) for axis in (
        [1 + cosine, 1 - cosine, sine], [1 - cosine, 1 + cosine, -sine], [-sine, sine, cosine]))
    near = a - b <= EQUAL
    slope = torch.where(near, direct - mixed, (p - r) / torch.where(near, 1.0, a - b))
    turning = 4 * (slope * b - r) / (a * b * (a + b))
    cross = first[:, None] * second
    return density, stress, (
        (direct - larger) / (a * a) * first[:, None] * first
        + (direct - smaller) / (b * b) * second[:, None] * second
        + mixed / (a * b) * (cross + cross.transpose(0, 1)) + turning * turn[:, None] * turn)


def tension(stress: Tensor) -> Tensor:
    """Stresses (3, T, B) with the negative eigenvalues of their tensors set to zero."""
    mean, half = (stress[0] + stress[1]) / 2, (stress[0] - stress[1]) / 2
    radius = torch.hypot(half, stress[2])
    low, high = (mean - radius).clamp(min=0), (mean + radius).clamp(min=0)
    turn = (high - low) / torch.where(radius > 0, 2 * radius, 1.0)
    mean = (high + low) / 2
    return torch.stack([mean + turn * half, mean - turn * half, turn * stress[2]])


def raise_eigenvalues(matrix: Tensor, floor: Tensor, share: Tensor) -> None:
    """Raise eigenvalues of symmetric matrices (3, 3, ...) to at least ``floor``, in place; only the
    ``share`` of the change is added.

    The change is a polynomial of matrix - floor that interpolates max(-x, 0) at its eigenvalues.
    Where they cluster it is exact, as then all but its linear terms vanish or are small.
    """
    moved = matrix.clone()
    moved.diagonal(dim1=0, dim2=1).sub_(floor[..., None])
    a, b, c = (moved[k, k] for k in range(3))
    mean = (a + b + c) / 3
    p, q, r = a - mean, b - mean, c - mean
    d, e, f = moved[1, 2], moved[0, 2], moved[0, 1]
    dd, ee, ff = d * d, e * e, f * f
    size = ((p * p + q * q + r * r) / 6 + (dd + ee + ff) / 3).sqrt()
    size = size.clamp(min=1e-150)
    half = 0.5 * (p * q * r - p * dd - q * ee - r * ff) + d * e * f
    angle = (half / size / size / size).clamp(-1, 1).acos() / 3
    high, low = (mean + 2 * size * (angle + turn).cos() for turn in (0.0, 2 / 3 * torch.pi))
    middle = torch.minimum(torch.maximum(3 * mean - high - low, low), high)
    at = [(-x).clamp(min=0) for x in (low, middle, high)]

    def slope(first: Tensor, second: Tensor, change: Tensor) -> Tensor:
        return torch.where(second > first, change / (second - first), 0.0)

    first, second = slope(low, middle, at[1] - at[0]), slope(middle, high, at[2] - at[1])
    first = torch.where(middle > low, first, -(low < 0).to(first))
    second = torch.where(high > middle, second, first)
    curve = share * slope(low, high, second - first)
    line, level = share * first - curve * (low + middle), share * (at[0] - first * low)
    level = level + curve * low * middle
    matrix.addcmul_(line, moved).addcmul_(curve, contracted(moved, moved))
    matrix.diagonal(dim1=0, dim2=1).add_(level[..., None])


def contracted(left: Tensor, right: Tensor) -> Tensor:
    """Products of (K, P, ...) and (K, Q, ...), added up over K: (P, Q, ...)."""
    total = left[0][:, None] * right[0]
    for a, b in zip(left[1:], right[1:], strict=True):
        total = total.addcmul(a[:, None], b)
    return total


def barrier(angle: Tensor, pole: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """The barrier of :mod:`sim.energies.fold_barrier` and two derivatives at angles (3, T, B), rad,
    per unit of scale."""
    over = angle.abs() - LIMIT_START * pole
    bent = over > 0
    remaining = torch.where(bent, pole - angle.abs(), 1.0)
    log = (remaining / ((1 - LIMIT_START) * pole)).log()
    ratio = over / remaining
    terms = (-over * over * log, angle.sign() * over * (ratio - 2 * log),
             (4 + ratio) * ratio - 2 * log)
    value, slope, bend = (torch.where(bent, term, 0.0) for term in terms)
    return value, slope, bend


def keeps_distance(before: Tensor, after: Tensor, pole: Tensor) -> Tensor:
    """Whether steps keep their angles (3, T, B) from the poles, for each drape (B,)."""
    turn = (after - before + torch.pi) % (2 * torch.pi) - torch.pi
    reached = (before + turn).abs()
    near = torch.minimum(pole - before.abs(), (1 - LIMIT_START) * pole)
    kept = ~(reached > LIMIT_START * pole) | (pole - reached >= MIN_REMAINING * near)
    return kept.flatten(0, 1).all(0)
