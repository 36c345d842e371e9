"""Moduli of the bending law along a direction: of cylindrical bending, and of free strips.

A strip at the angle phi to the warp that bends to a cylinder has the curvature S = kappa n n^T with
n = (cos phi, sin phi). A narrow strip with free sides has only the moment along its length: it
twists and curves across, and is softer.
"""

import numpy as np

from sim.energies import plate_law
from sim.material import Fabric, plate_constants

_SMALL = 0.01  # reduced curvature below the softening limit of every term of the law


def cylinder_torque(fabric: Fabric, angle: float, curvature: np.ndarray) -> np.ndarray:
    """Torque (K,), N, per width of cylinders of ``curvature`` (K,), 1/m, at ``angle``, rad.

    The derivative of the plate's energy (:mod:`sim.energies.plate_law`) with respect to kappa.
    """
    law = plate_law.constants(fabric)
    cos, sin = np.cos(angle), np.sin(angle)
    direction = np.array([cos**2, sin**2, cos * sin])
    return plate_law.stresses(curvature[:, None] * direction, law)[0] @ direction


def cylinder_moduli(fabric: Fabric, angle: float) -> tuple[float, float]:
    """k(phi): alpha, N·m, and beta, N·m², of a cylinder bent along ``angle`` (rad from warp).

    Its torque is alpha kappa + beta kappa² up to the softening limit in warp, bias and weft, and
    in other directions as long as no term of the law has reached its limit.
    """
    kappa = _SMALL / max(np.abs(fabric.beta / fabric.alpha).max(), 1e-6)
    once, twice = cylinder_torque(fabric, angle, np.array([kappa, 2 * kappa]))
    return float((4 * once - twice) / (2 * kappa)), float((twice - 2 * once) / (2 * kappa**2))


def free_modulus(fabric: Fabric, angle: float) -> float:
    """Linear modulus, N·m, of a narrow free strip along ``angle``, rad, for small deflections.

    1/(m D^-1 m) with the plate's stiffness D (3, 3) for (Sxx, Syy, Sxy) and the components m of a
    unit moment along the strip: the other two moments are zero.
    """
    a11, a22, a12, a66 = plate_constants(fabric.alpha)
    stiffness = np.array([[a11, a12, 0.0], [a12, a22, 0.0], [0.0, 0.0, 4 * a66]])
    cos, sin = np.cos(angle), np.sin(angle)
    moments = np.array([cos**2, sin**2, 2 * cos * sin])
    return float(1 / (moments @ np.linalg.solve(stiffness, moments)))
