"""Energy per area of the orthotropic, softening plate as a function of its curvature.

With S = (Sxx, Syy, Sxy) in warp/weft axes (1/m),

    psi = 1/2 a(S) H(u),   a = A11 Sxx² + A22 Syy² + 2 A12 Sxx Syy + 4 A66 Sxy²,
    u = q(S)/|S|,          q = rho_w Sxx² + rho_f Syy² + 2 rho_t Sxy²,

H(u) = 2 e(u)/u², e the integral of t, and t(u) = u (1 - u) up to u_c, continued with its slope
1 - 2 u_c. Cloth bent to a cylinder along warp, bias or weft carries exactly the torque
alpha kappa + beta kappa² (up to u_c); other directions follow smoothly. psi is positive for
S != 0, whatever the sign of the quadratic moduli. Constants: :mod:`sim.material`.
"""

import numba
import numpy as np

CONSTANTS = ("A11", "A22", "A12", "A66", "rho_w", "rho_f", "rho_t", "u_c")


@numba.njit(inline="always")
def _shape(u, limit):
    """H, dH/du, d²H/du²."""
    if u <= limit:
        return 1.0 - 2.0 * u / 3.0, -2.0 / 3.0, 0.0
    # e(u) = s u²/2 + c u + d with the slope s and continuity at the limit
    s = 1.0 - 2.0 * limit
    c = limit * limit
    d = -limit * limit * limit / 3.0
    v = 1.0 / u
    return (
        s + 2.0 * v * (c + d * v),
        -2.0 * v * v * (c + 2.0 * d * v),
        4.0 * v * v * v * (c + 3.0 * d * v),
    )


@numba.njit(cache=True)
def energy(s, law):
    """psi, J/m², at curvature s (3,) for the constants law (8,), see CONSTANTS."""
    n = np.sqrt(s[0] * s[0] + s[1] * s[1] + 2.0 * s[2] * s[2])
    if n < 1e-9:
        return 0.0
    a = law[0] * s[0] ** 2 + law[1] * s[1] ** 2 + 2.0 * law[2] * s[0] * s[1]
    a += 4.0 * law[3] * s[2] ** 2
    u = (law[4] * s[0] ** 2 + law[5] * s[1] ** 2 + 2.0 * law[6] * s[2] ** 2) / n
    h, _, _ = _shape(u, law[7])
    return 0.5 * a * h


@numba.njit(cache=True)
def derivatives(s, law, g, h):
    """Fill g (3,) and h (3, 3) with the derivatives of psi by s (3,); law (8,) as in energy."""
    da0 = 2.0 * (law[0] * s[0] + law[2] * s[1])
    da1 = 2.0 * (law[1] * s[1] + law[2] * s[0])
    da2 = 8.0 * law[3] * s[2]
    h[0, 0], h[1, 1], h[2, 2] = law[0], law[1], 4.0 * law[3]
    h[0, 1] = h[1, 0] = law[2]
    h[0, 2] = h[2, 0] = h[1, 2] = h[2, 1] = 0.0
    n = np.sqrt(s[0] * s[0] + s[1] * s[1] + 2.0 * s[2] * s[2])
    if n < 1e-9:
        # u is of first order in S: at S = 0 only the quadratic form remains.
        g[0], g[1], g[2] = 0.5 * da0, 0.5 * da1, 0.5 * da2
        return
    a = 0.5 * (da0 * s[0] + da1 * s[1] + da2 * s[2])
    u = (law[4] * s[0] ** 2 + law[5] * s[1] ** 2 + 2.0 * law[6] * s[2] ** 2) / n
    shape, slope, bend = _shape(u, law[7])
    da = (da0, da1, da2)
    metric = (1.0, 1.0, 2.0)
    weight = (2.0 * law[4], 2.0 * law[5], 4.0 * law[6])
    du, dn = np.empty(3), np.empty(3)
    for i in range(3):
        dn[i] = metric[i] * s[i] / n
        du[i] = (weight[i] * s[i] - u * dn[i]) / n
    for i in range(3):
        g[i] = 0.5 * (shape * da[i] + a * slope * du[i])
        for j in range(3):
            ddu = -(du[i] * dn[j] + dn[i] * du[j]) + u * dn[i] * dn[j] / n
            if i == j:
                ddu += weight[i] - u * metric[i] / n
            ddu /= n
            h[i, j] = shape * h[i, j] + 0.5 * (
                slope * (da[i] * du[j] + du[i] * da[j])
                + a * (bend * du[i] * du[j] + slope * ddu)
            )
