"""Energy per area of the orthotropic, softening plate as a function of its curvature.

With S = (Sxx, Syy, Sxy) in warp/weft axes (1/m),

    psi = 1/2 a H(g/sqrt(a)) + w F_w(d) + (1 - w) F_f(d) + F_b(2 |Sxy|),

    a = A11 Sxx² + A22 Syy² + 2 A12 Sxx Syy + 4 A66 Sxy² + 4 (A16 Sxx + A26 Syy) Sxy,
    d = |Sxx - Syy|,   g = g_w Sxx² + g_f Syy² + 2 g_t Sxy²,   w = A11 Sxx²/(A11 Sxx² + A22 Syy²),

H the shape of a softening law (:func:`sim.material.softening_shape`). The first term is convex
where g is a multiple of a. It softens at least as fast as the fabric in each direction, and the
other terms correct the excess: F_w and F_f vanish for cloth bent along the bias, where Sxx = Syy,
and F_b along the yarns, where Sxy = 0. Each is the difference of two torque laws of one direction,
convex in its argument.

psi is positive for S != 0 and any sign of the quadratic moduli. A16 and A26 are zero in a plate
whose diagonals are equal; with them alpha_bias is the mean of both diagonals (:func:`constants`).

:func:`respond` adds hysteresis (:mod:`sim.energies.bending_variants`).
"""

from typing import NamedTuple

import numba
import numpy as np

from sim.material import BIAS, SOFTENING_LIMIT, WARP, WEFT, Fabric, plate_constants, softening_shape


class PlateConstants(NamedTuple):
    """Constants of a fabric's law, SI units; see this module and :func:`constants`."""

    A11: float
    A22: float
    A12: float
    A66: float
    A16: float
    A26: float
    alpha_bias: float
    g_w: float
    g_f: float
    g_t: float
    base_w: float
    base_f: float
    base_b: float
    rho_w: float
    rho_f: float
    rho_b: float
    u_c: float


def constants(fabric: Fabric, skew: float = 0.0) -> PlateConstants:
    """Constants of a fabric's law. The ``skew`` is that of the bending coupled with twist (D16 and
    D26 of a laminate) over the largest of a stable plate, -1 to 1: in a plate that is alike along
    warp, weft and bias the difference of its diagonals over their sum.

    rho = -beta/alpha (m) is the softening rate of a direction, r = rho/sqrt(alpha) the rate with
    respect to sqrt(a). If r is equal in all directions, the law is the first term alone. If the
    bias softens faster than warp and weft on average, r of the first term is increased by the
    difference along both yarns; if slower, along the bias. base = sqrt(alpha) r are the increased
    rates. All constants are continuous in the moduli.
    """
    alpha, root = fabric.alpha, np.sqrt(fabric.alpha)
    rho = -fabric.beta / alpha
    rate = rho / root
    excess = rate[BIAS] - (rate[WARP] + rate[WEFT]) / 2
    added = np.full(3, max(excess, 0.0))
    added[BIAS] = max(-excess, 0.0)
    g = (rate + added) * alpha
    base = rho + added * root
    a11, a22, a12, a66 = plate_constants(alpha)
    # The form, scaled to a diagonal of ones, has the determinant (1 - r) (1 + r - 2 coupling²).
    coupling = skew and skew * np.sqrt((1 + a12 / np.sqrt(a11 * a22)) / 2 * a66)
    return PlateConstants(*map(float, (
        a11, a22, a12, a66, coupling * root[WARP], coupling * root[WEFT], alpha[BIAS],
        g[WARP], g[WEFT], 2 * g[BIAS] - (g[WARP] + g[WEFT]) / 2,
        base[WARP], base[WEFT], base[BIAS], rho[WARP], rho[WEFT], rho[BIAS], SOFTENING_LIMIT,
    )))  # fmt: skip


def form(law: PlateConstants) -> np.ndarray:
    """(3, 3) N·m, twice the energy per area of flat cloth by (Sxx, Syy, Sxy)."""
    return np.array([[law.A11, law.A12, 2 * law.A16], [law.A12, law.A22, 2 * law.A26],
                     [2 * law.A16, 2 * law.A26, 4 * law.A66]])


class Variant(NamedTuple):
    """Constants of hysteresis: the form P of HB², N², and the ``limit`` Y, N, at which friction is
    saturated; the weights ``slid`` of F(S - S1) and ``returned`` of -F(S), each 0 or 1
    (:mod:`sim.energies.bending_variants`)."""

    p_xx: float = 0.0
    p_yy: float = 0.0
    p_mixed: float = 0.0
    p_xy: float = 0.0
    limit: float = 1.0
    slid: float = 0.0
    returned: float = 0.0


PLAIN = Variant()
_shape = numba.njit(inline="always")(softening_shape)


@numba.njit(inline="always")
def _correction(k, alpha, base, rho, limit):
    """F and two derivatives at k >= 0: energy of the law of ``rho`` less that of ``base``."""
    fast, fast1, _ = _shape(base * k, limit)
    slow, slow1, _ = _shape(rho * k, limit)
    return (0.5 * alpha * k * k * (slow - fast),
            alpha * k * (slow - fast + 0.5 * k * (rho * slow1 - base * fast1)),
            2.0 * alpha * (min(base * k, limit) - min(rho * k, limit)))


@numba.njit(cache=True, error_model="numpy")
def derivatives(s, law, g, h):
    """psi, J/m², at curvature s (3,) for the constants ``law``; fills g (3,) and, unless it is
    empty, h (3, 3) with its derivatives by s."""
    da = (2.0 * (law.A11 * s[0] + law.A12 * s[1]) + 4.0 * law.A16 * s[2],
          2.0 * (law.A22 * s[1] + law.A12 * s[0]) + 4.0 * law.A26 * s[2],
          8.0 * law.A66 * s[2] + 4.0 * (law.A16 * s[0] + law.A26 * s[1]))
    if len(h):
        h[0, 0], h[1, 1], h[2, 2] = law.A11, law.A22, 4.0 * law.A66
        h[0, 1] = h[1, 0] = law.A12
        h[0, 2] = h[2, 0] = 2.0 * law.A16
        h[1, 2] = h[2, 1] = 2.0 * law.A26
    a = 0.5 * (da[0] * s[0] + da[1] * s[1] + da[2] * s[2])
    if a <= 0.0:
        # u is of first order in S: at S = 0 only the quadratic form contributes.
        g[0], g[1], g[2] = 0.0, 0.0, 0.0
        return 0.0
    n = np.sqrt(a)
    u = (law.g_w * s[0] ** 2 + law.g_f * s[1] ** 2 + 2.0 * law.g_t * s[2] ** 2) / n
    shape, slope, bend = _shape(u, law.u_c)
    weight = (2.0 * law.g_w, 2.0 * law.g_f, 4.0 * law.g_t)
    dn = (0.5 * da[0] / n, 0.5 * da[1] / n, 0.5 * da[2] / n)
    du = ((weight[0] * s[0] - u * dn[0]) / n, (weight[1] * s[1] - u * dn[1]) / n,
          (weight[2] * s[2] - u * dn[2]) / n)
    for i in range(3):
        g[i] = 0.5 * (shape * da[i] + a * slope * du[i])
        for j in range(len(h)):
            ddu = -(du[i] * dn[j] + dn[i] * du[j]) + u * (dn[i] * dn[j] - h[i, j]) / n
            if i == j:
                ddu += weight[i]
            ddu /= n
            h[i, j] = shape * h[i, j] + 0.5 * (
                slope * (da[i] * du[j] + du[i] * da[j])
                + a * (bend * du[i] * du[j] + slope * ddu)
            )
    total = 0.5 * a * shape
    if law.base_b > law.rho_b:
        work, force, stiffness = _correction(2.0 * abs(s[2]), law.alpha_bias, law.base_b,
                                             law.rho_b, law.u_c)
        total += work
        g[2] += 2.0 * force * np.sign(s[2])
        if len(h):
            h[2, 2] += 4.0 * stiffness
    if law.base_w > law.rho_w and s[0] != s[1]:
        total += _add_yarns(s, law, g, h)
    return total


@numba.njit(cache=True, error_model="numpy")
def _add_yarns(s, law, g, h):
    """w F_w + (1 - w) F_f = F_f + w (F_w - F_f); its derivatives are added to g and, unless it is
    empty, h."""
    d = abs(s[0] - s[1])
    side = np.sign(s[0] - s[1])
    f_w, force_w, stiff_w = _correction(d, law.A11, law.base_w, law.rho_w, law.u_c)
    f_f, force_f, stiff_f = _correction(d, law.A22, law.base_f, law.rho_f, law.u_c)
    more, pull = f_w - f_f, side * (force_w - force_f)
    warp, weft = law.A11 * s[0] ** 2, law.A22 * s[1] ** 2
    n = warp + weft
    w = warp / n
    wx = 2.0 * law.A11 * s[0] * weft / n**2
    wy = -2.0 * law.A22 * s[1] * warp / n**2
    force = side * force_f + w * pull
    g[0] += force + wx * more
    g[1] += -force + wy * more
    if len(h) == 0:
        return f_f + w * more
    wxx = 2.0 * law.A11 * weft / n**2 * (1.0 - 4.0 * w)
    wyy = -2.0 * law.A22 * warp / n**2 * (4.0 * w - 3.0)
    wxy = 4.0 * law.A11 * law.A22 * s[0] * s[1] / n**2 * (2.0 * w - 1.0)
    stiff = stiff_f + w * (stiff_w - stiff_f)
    h[0, 0] += stiff + 2.0 * wx * pull + wxx * more
    h[1, 1] += stiff - 2.0 * wy * pull + wyy * more
    mixed = -stiff + (wy - wx) * pull + wxy * more
    h[0, 1] += mixed
    h[1, 0] += mixed
    return f_f + w * more


@numba.njit(cache=True, error_model="numpy")
def respond(curvatures, origins, law, variant, tangents=True):
    """Energies (N,), J/m², of a variant of the plate at curvatures (N, 3) with the ``origins`` S1
    (N, 3); their first (N, 3), N, and second (N, 3, 3), N·m, derivatives by the curvatures. Without
    ``tangents`` the latter are empty."""
    density, size = np.empty(len(curvatures)), 3 if tangents else 0
    stress, tangent = np.empty((len(curvatures), 3)), np.empty((len(curvatures), size, size))
    for t in range(len(curvatures)):
        s, g, h = curvatures[t], stress[t], tangent[t]
        total = derivatives(s, law, g, h)
        if variant.slid != 0.0:
            total += _add_friction(s - origins[t], variant.slid, variant, g, h)
        if variant.returned != 0.0:
            total += _add_friction(s, -variant.returned, variant, g, h)
        density[t] = total
    return density, stress, tangent


@numba.njit(cache=True, error_model="numpy")
def _add_friction(change, weight, variant, g, h):
    """``weight`` times the potential of the friction F, J/m², at a ``change`` of curvature (3,);
    its derivatives are added to g and, unless it is empty, h."""
    x, y, z = change
    limit = variant.limit
    pull = ((variant.p_xx * x + variant.p_mixed * y) / limit,
            (variant.p_mixed * x + variant.p_yy * y) / limit, variant.p_xy * z / limit)
    ratio = np.sqrt((pull[0] * x + pull[1] * y + pull[2] * z) / limit)  # |C|/Y
    if ratio < 1.0:
        work = 0.625 * ratio**2 - ratio**6 / 24
        over, bend = 1.25 - 0.25 * ratio**4, -(ratio**2)  # f(y)/y, (f'(y) - f(y)/y)/y²
    else:
        work = 0.625 - 1 / 24 + ratio - 1.0
        over, bend = 1 / ratio, -1 / ratio**3
    for i in range(3):
        g[i] += weight * over * pull[i]
        for j in range(len(h)):
            h[i, j] += weight * bend * pull[i] * pull[j] / limit
    if len(h):
        h[0, 0] += weight * over * variant.p_xx / limit
        h[1, 1] += weight * over * variant.p_yy / limit
        h[2, 2] += weight * over * variant.p_xy / limit
        h[0, 1] += weight * over * variant.p_mixed / limit
        h[1, 0] += weight * over * variant.p_mixed / limit
    return weight * limit * work
