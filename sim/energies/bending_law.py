"""Energy per area of the orthotropic, softening plate as a function of its curvature.

With S = (Sxx, Syy, Sxy) in warp/weft axes (1/m),

    psi = 1/2 a H(g/sqrt(a)) + w F_w(d) + (1 - w) F_f(d) + F_b(2 |Sxy|),

    a = A11 Sxx² + A22 Syy² + 2 A12 Sxx Syy + 4 A66 Sxy²,     d = |Sxx - Syy|,
    g = g_w Sxx² + g_f Syy² + 2 g_t Sxy²,     w = A11 Sxx²/(A11 Sxx² + A22 Syy²),

H the shape of a softening law (:func:`sim.material.softening_shape`). The first term is convex
where g is a multiple of a. It softens at least as fast as the fabric in each direction, and the
other terms correct the excess: F_w and F_f vanish for cloth bent along the bias, where Sxx = Syy,
and F_b along the yarns, where Sxy = 0. Each is the difference of two torque laws of one direction,
convex in its argument.

Thus cloth bent to a cylinder along warp, bias or weft carries exactly the torque
alpha kappa + beta kappa² (up to u_c), with a smooth interpolation between these directions. psi is
positive for S != 0 and any sign of the quadratic moduli.
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


def constants(fabric: Fabric) -> PlateConstants:
    """Constants of a fabric's law.

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
    return PlateConstants(*map(float, (
        *plate_constants(alpha), alpha[BIAS],
        g[WARP], g[WEFT], 2 * g[BIAS] - (g[WARP] + g[WEFT]) / 2,
        base[WARP], base[WEFT], base[BIAS], rho[WARP], rho[WEFT], rho[BIAS], SOFTENING_LIMIT,
    )))  # fmt: skip


_shape = numba.njit(inline="always")(softening_shape)


@numba.njit(inline="always")
def _correction(k, alpha, base, rho, limit):
    """F and two derivatives at k >= 0: energy of the law of ``rho`` less that of ``base``."""
    fast, fast1, _ = _shape(base * k, limit)
    slow, slow1, _ = _shape(rho * k, limit)
    return (0.5 * alpha * k * k * (slow - fast),
            alpha * k * (slow - fast + 0.5 * k * (rho * slow1 - base * fast1)),
            2.0 * alpha * (min(base * k, limit) - min(rho * k, limit)))


@numba.njit(cache=True)
def energy(s, law):
    """psi, J/m², at curvature s (3,) for the constants ``law``."""
    x, y, z = s[0], s[1], s[2]
    limit = law.u_c
    a = law.A11 * x * x + law.A22 * y * y + 2.0 * law.A12 * x * y + 4.0 * law.A66 * z * z
    if a <= 0.0:
        return 0.0
    u = (law.g_w * x * x + law.g_f * y * y + 2.0 * law.g_t * z * z) / np.sqrt(a)
    h, _, _ = _shape(u, limit)
    total = 0.5 * a * h
    if law.base_b > law.rho_b:
        total += _correction(2.0 * abs(z), law.alpha_bias, law.base_b, law.rho_b, limit)[0]
    d = abs(x - y)
    if law.base_w > law.rho_w and d > 0.0:
        warp, weft = law.A11 * x * x, law.A22 * y * y
        f_w, _, _ = _correction(d, law.A11, law.base_w, law.rho_w, limit)
        f_f, _, _ = _correction(d, law.A22, law.base_f, law.rho_f, limit)
        total += (warp * f_w + weft * f_f) / (warp + weft)
    return total


@numba.njit(cache=True)
def derivatives(s, law, g, h):
    """Fill g (3,) and h (3, 3) with the derivatives of psi by s (3,)."""
    da0 = 2.0 * (law.A11 * s[0] + law.A12 * s[1])
    da1 = 2.0 * (law.A22 * s[1] + law.A12 * s[0])
    da2 = 8.0 * law.A66 * s[2]
    h[0, 0], h[1, 1], h[2, 2] = law.A11, law.A22, 4.0 * law.A66
    h[0, 1] = h[1, 0] = law.A12
    h[0, 2] = h[2, 0] = h[1, 2] = h[2, 1] = 0.0
    a = 0.5 * (da0 * s[0] + da1 * s[1] + da2 * s[2])
    if a <= 0.0:
        # u is of first order in S: at S = 0 only the quadratic form contributes.
        g[0], g[1], g[2] = 0.0, 0.0, 0.0
        return
    n = np.sqrt(a)
    u = (law.g_w * s[0] ** 2 + law.g_f * s[1] ** 2 + 2.0 * law.g_t * s[2] ** 2) / n
    shape, slope, bend = _shape(u, law.u_c)
    da = (da0, da1, da2)
    weight = (2.0 * law.g_w, 2.0 * law.g_f, 4.0 * law.g_t)
    du, dn = np.empty(3), np.empty(3)
    for i in range(3):
        dn[i] = 0.5 * da[i] / n
        du[i] = (weight[i] * s[i] - u * dn[i]) / n
    for i in range(3):
        g[i] = 0.5 * (shape * da[i] + a * slope * du[i])
        for j in range(3):
            ddu = -(du[i] * dn[j] + dn[i] * du[j]) + u * (dn[i] * dn[j] - h[i, j]) / n
            if i == j:
                ddu += weight[i]
            ddu /= n
            h[i, j] = shape * h[i, j] + 0.5 * (
                slope * (da[i] * du[j] + du[i] * da[j])
                + a * (bend * du[i] * du[j] + slope * ddu)
            )
    if law.base_b > law.rho_b:
        _, force, stiffness = _correction(2.0 * abs(s[2]), law.alpha_bias, law.base_b, law.rho_b,
                                          law.u_c)
        g[2] += 2.0 * force * np.sign(s[2])
        h[2, 2] += 4.0 * stiffness
    if law.base_w > law.rho_w and s[0] != s[1]:
        _add_yarns(s, law, g, h)


@numba.njit(cache=True)
def _add_yarns(s, law, g, h):
    """Add the derivatives of w F_w + (1 - w) F_f = F_f + w (F_w - F_f)."""
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
    wxx = 2.0 * law.A11 * weft / n**2 * (1.0 - 4.0 * w)
    wyy = -2.0 * law.A22 * warp / n**2 * (4.0 * w - 3.0)
    wxy = 4.0 * law.A11 * law.A22 * s[0] * s[1] / n**2 * (2.0 * w - 1.0)
    force = side * force_f + w * pull
    stiff = stiff_f + w * (stiff_w - stiff_f)
    g[0] += force + wx * more
    g[1] += -force + wy * more
    h[0, 0] += stiff + 2.0 * wx * pull + wxx * more
    h[1, 1] += stiff - 2.0 * wy * pull + wyy * more
    mixed = -stiff + (wy - wx) * pull + wxy * more
    h[0, 1] += mixed
    h[1, 0] += mixed


@numba.njit(cache=True)
def energies(s, law):
    """psi (N,), J/m²."""
    psi = np.empty(len(s))
    for t in range(len(s)):
        psi[t] = energy(s[t], law)
    return psi


@numba.njit(cache=True)
def stresses(s, law):
    """Derivatives of psi, (N, 3) and (N, 3, 3)."""
    g, h = np.empty((len(s), 3)), np.empty((len(s), 3, 3))
    for t in range(len(s)):
        derivatives(s[t], law, g[t], h[t])
    return g, h
