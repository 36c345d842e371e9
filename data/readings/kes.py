"""Readings of the KES-FB2 bending tester."""

import numpy as np

from common.types import Density
from data.fabrics.fabrics import ClothProperties
from data.readings.quantity import STANDARD_GRAVITY, Quantity, moduli_at
from sim.material import torque

KES_CURVATURES = (50.0, 150.0)  # 1/m, of the secant
GF_CM = 1e-3 * STANDARD_GRAVITY * 1e-2  # N·m, of 1 gf·cm²/cm
GF_CM_PER_CM = 1e-3 * STANDARD_GRAVITY  # N, of 1 gf·cm/cm


def kes(alpha: np.ndarray, beta: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """B of KES-FB2, N·m, its 2HB, N, and whether the moduli do not determine them, of moduli, N·m
    and N·m², of the same shape.

    B is the secant of the torque between 0.5 and 1.5 cm⁻¹, alpha + 200/m beta within the quadratic
    law. KES's loading curve is B kappa + HB: 2HB is twice the torque of that secant at zero
    curvature. Beyond the peak of alpha kappa + beta kappa² the moduli do not determine the torque;
    it is that of the law's straight line there.
    """
    low, high = (torque(np.asarray(at), alpha, beta) for at in KES_CURVATURES)
    secant = (high - low) / (KES_CURVATURES[1] - KES_CURVATURES[0])
    return (secant, 2 * (low - KES_CURVATURES[0] * secant),
            alpha + 2 * beta * KES_CURVATURES[1] < 0)


def _b(cloth: ClothProperties, density: Density) -> np.ndarray:
    return kes(*moduli_at(cloth, density))[0] / GF_CM


def _2hb(cloth: ClothProperties, density: Density) -> np.ndarray:
    return kes(*moduli_at(cloth, density))[1] / GF_CM_PER_CM


QUANTITIES = (
    Quantity("kes_b_gf_cm2_per_cm", 3, 0.10, _b, "KES B [gf·cm²/cm]", limits=(2e-4, 20.0)),
    Quantity("kes_2hb_gf_cm_per_cm", 3, 0.15, _2hb, "KES 2HB [gf·cm/cm]", limits=(1e-5, 20.0)))
