"""The bending law along a direction of the cloth: held to a cylinder, and free to relax.

A strip at the angle phi to the warp that bends as a cylinder has the curvature S = kappa n n^T,
n = (cos phi, sin phi), for which the plate's energy (:mod:`sim.energies.plate_law`) is that of a
one-dimensional law of the same form: torque alpha kappa + beta kappa² up to the softening limit.
A narrow strip free at its sides carries no moment but the one along it. It twists and curves
across until that holds, and is softer.
"""

import numpy as np

from sim.material import Fabric, plate_constants, softening


def cylinder_moduli(fabric: Fabric, angle: float) -> tuple[float, float]:
    """k(phi): alpha N·m and beta N·m² of a cylinder bent along ``angle`` (rad from warp)."""
    a11, a22, a12, a66 = plate_constants(fabric.alpha)
    rho_w, rho_f, rho_t = softening(fabric.alpha, fabric.beta)
    c2, s2 = np.cos(angle) ** 2, np.sin(angle) ** 2
    alpha = a11 * c2**2 + a22 * s2**2 + (2 * a12 + 4 * a66) * c2 * s2
    rho = rho_w * c2**2 + rho_f * s2**2 + 2 * rho_t * c2 * s2
    return float(alpha), float(-rho * alpha)


def free_modulus(fabric: Fabric, angle: float) -> float:
    """Linear modulus, N·m, of a narrow free strip along ``angle``, for small deflections.

    1/(D^-1)_11, D (3, 3) the plate's stiffness in the strip's axes, from (Sxx, Syy, Sxy) to
    energy: the other two curvatures relax.
    """
    a11, a22, a12, a66 = plate_constants(fabric.alpha)
    c, s = np.cos(angle), np.sin(angle)
    to_material = np.array(
        [[c * c, s * s, -2 * c * s], [s * s, c * c, 2 * c * s], [c * s, -c * s, c * c - s * s]]
    )
    stiffness = np.array([[a11, a12, 0.0], [a12, a22, 0.0], [0.0, 0.0, 4 * a66]])
    return float(1 / np.linalg.inv(to_material.T @ stiffness @ to_material)[0, 0])
