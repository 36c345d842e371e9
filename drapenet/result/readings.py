"""Readings of virtual cantilever and KES testers.

They measure the law over a range of curvatures, not alpha, so both tests are simulated with the law
of each posterior sample. Constants of the standards' editions: ``docs/notation.md``. Arrays alpha,
N·m, and beta, N·m², have the same shape.
"""

import json
from functools import cache
from pathlib import Path

import numpy as np

from common.types import Density
from sim.material import torque
from sim.rig import GRAVITY

KES_CURVATURES = (50.0, 150.0)  # 1/m, of the secant
STANDARD_GRAVITY = 9.80665  # m/s², of gram-force
MG_CM = 1e-6 * STANDARD_GRAVITY * 1e-2  # N·m, of 1 mg·cm
GF_CM = 1e-3 * STANDARD_GRAVITY * 1e-2  # N·m, of 1 gf·cm²/cm
GF_CM_PER_CM = 1e-3 * STANDARD_GRAVITY  # N, of 1 gf·cm/cm
SOFTENING = np.sinh(np.linspace(np.arcsinh(-4.0), np.arcsinh(10.0), 240))
"""-beta/(alpha l) of the strips in ``weights/strips.json``, l = (alpha/rho g)^(1/3)."""


@cache
def strip_lengths() -> np.ndarray:
    """(240,) lengths, in units of l, of the strips of :data:`SOFTENING` that end on the plane.

    Heavy elasticas, integrated with errors below 1e-6: ``tests/drapenet/test_readings.py``.
    """
    file = Path(__file__).parents[1] / "weights" / "strips.json"
    return np.array(json.loads(file.read_text(encoding="utf-8")))


def bending_length(alpha: np.ndarray, beta: np.ndarray, density: Density) -> np.ndarray:
    """Bending length, m: half the length of the strip whose tip reaches the plane at 41.5° (Peirce;
    ISO 9073-7, ASTM D1388 option A, FAST-2). The flexural rigidity is rho g times its cube.
    """
    natural = np.cbrt(alpha / (density * GRAVITY))
    return natural * np.interp(-beta / (alpha * natural), SOFTENING, strip_lengths()) / 2


def kes(alpha: np.ndarray, beta: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """B of KES-FB2, N·m, its 2HB, N, and whether the moduli do not determine them.

    B is the secant of the torque between 0.5 and 1.5 cm⁻¹, alpha + 200/m beta within the quadratic
    law. KES's loading curve is B kappa + HB: 2HB is twice the torque of that secant at zero
    curvature. Beyond the peak of alpha kappa + beta kappa² the moduli do not determine the torque.
    """
    low, high = (torque(np.asarray(at), alpha, beta) for at in KES_CURVATURES)
    secant = (high - low) / (KES_CURVATURES[1] - KES_CURVATURES[0])
    return (secant, 2 * (low - KES_CURVATURES[0] * secant),
            alpha + 2 * beta * KES_CURVATURES[1] < 0)
