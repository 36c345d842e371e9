"""The bending law along a direction of the cloth: held to a cylinder, and free to relax.

A strip at the angle phi to the warp that bends as a cylinder has the curvature S = kappa n n^T,
n = (cos phi, sin phi). A narrow strip free at its sides carries no moment but the one along it.
It twists and curves across until that holds, and is softer.
"""

import numpy as np

from sim.energies import plate_law
from sim.material import Fabric, plate_constants

_SMALL = 0.01  # reduced curvature at which no term of the law has reached its softening limit


def cylinder_torque(fabric: Fabric, angle: float, curvature: np.ndarray) -> np.ndarray:
    """(K,) N, torque per width of cylinders of ``curvature`` (K,) 1/m bent along ``angle``.

    That is, the derivative by kappa of the plate's energy (:mod:`sim.energies.plate_law`).
    """
    law = plate_law.constants(fabric)
    cos, sin = np.cos(angle), np.sin(angle)
    direction = np.array([cos**2, sin**2, cos * sin])
    return plate_law.stresses(curvature[:, None] * direction, law)[0] @ direction


def cylinder_moduli(fabric: Fabric, angle: float) -> tuple[float, float]:
    """k(phi): alpha N·m and beta N·m² of a cylinder bent along ``angle`` (rad from warp).

    Its torque is alpha kappa + beta kappa²: in warp, bias and weft up to the softening limit, in
    other directions while none of the law's terms has reached it.
    """
    kappa = _SMALL / max(np.abs(fabric.beta / fabric.alpha).max(), 1e-6)
    once, twice = cylinder_torque(fabric, angle, np.array([kappa, 2 * kappa]))
    return float((4 * once - twice) / (2 * kappa)), float((twice - 2 * once) / (2 * kappa**2))


def free_modulus(fabric: Fabric, angle: float) -> float:
    """Linear modulus, N·m, of a narrow free strip along ``angle``, for small deflections.

    1/(m D^-1 m), D (3, 3) the plate's stiffness against (Sxx, Syy, Sxy) and m the moments on
    these of a unit moment along the strip: the other two curvatures relax.
    """
    a11, a22, a12, a66 = plate_constants(fabric.alpha)
    stiffness = np.array([[a11, a12, 0.0], [a12, a22, 0.0], [0.0, 0.0, 4 * a66]])
    cos, sin = np.cos(angle), np.sin(angle)
    moments = np.array([cos**2, sin**2, 2 * cos * sin])
    return float(1 / (moments @ np.linalg.solve(stiffness, moments)))
