"""The bending law along a direction of the cloth: held to a cylinder, and free to relax.

A strip at the angle phi to the warp that bends as a cylinder has the curvature S = kappa n n^T,
n = (cos phi, sin phi), for which the plate's energy (:mod:`sim.energies.plate_law`) is that of a
torque alpha kappa + beta kappa². In warp, bias and weft that holds up to the softening limit, in
other directions while none of the law's terms has reached it. A narrow strip free at its sides
carries no moment but the one along it. It twists and curves across until that holds, and is
softer.
"""

import numpy as np

from sim.energies import plate_law
from sim.material import Fabric, plate_constants


def cylinder_moduli(fabric: Fabric, angle: float) -> tuple[float, float]:
    """k(phi): alpha N·m and beta N·m² of a cylinder bent along ``angle`` (rad from warp)."""
    law = dict(zip(plate_law.CONSTANTS, plate_law.constants(fabric), strict=True))
    c2, s2 = np.cos(angle) ** 2, np.sin(angle) ** 2
    warp, weft = law["A11"] * c2**2, law["A22"] * s2**2
    alpha = warp + weft + (2 * law["A12"] + 4 * law["A66"]) * c2 * s2
    g = law["g_w"] * c2**2 + law["g_f"] * s2**2 + 2 * law["g_t"] * c2 * s2
    # What the terms beside the first give back, at d = kappa |cos 2 phi|, 2 Sxy = kappa sin 2 phi
    back_w = law["A11"] * (law["base_w"] - law["rho_w"])
    back_f = law["A22"] * (law["base_f"] - law["rho_f"])
    back_b = law["alpha_bias"] * (law["base_b"] - law["rho_b"])
    yarns = (warp * back_w + weft * back_f) / (warp + weft)
    beta = (
        -g * np.sqrt(alpha)
        + np.abs(np.cos(2 * angle)) ** 3 * yarns
        + np.abs(np.sin(2 * angle)) ** 3 * back_b
    )
    return float(alpha), float(beta)


def cylinder_torque(fabric: Fabric, angle: float, curvature: np.ndarray) -> np.ndarray:
    """(K,) N, torque per width of cylinders of ``curvature`` (K,) 1/m bent along ``angle``."""
    law = plate_law.constants(fabric)
    along = np.array([np.cos(angle), np.sin(angle)])
    direction = np.array([along[0] ** 2, along[1] ** 2, along[0] * along[1]])
    stress, tangent = np.empty(3), np.empty((3, 3))
    torques = []
    for kappa in curvature:
        plate_law.derivatives(kappa * direction, law, stress, tangent)
        torques.append(stress @ direction)
    return np.array(torques)


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
