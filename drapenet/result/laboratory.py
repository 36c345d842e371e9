"""Readings of virtual cantilever and KES testers.

A tester measures the law over a range of curvatures, not alpha: at 41.5°, a fabric that softens
has a reading below its alpha. Both tests are therefore simulated with the law of each posterior
sample, which gives intervals of the readings.

Units: bending length mm; flexural rigidity G = rho g c³ in µN·m (FAST-2) and mg·cm (older
editions of ASTM D1388); KES-FB2's B in gf·cm²/cm and 2HB in gf·cm/cm. Constants of the standards'
editions: ``docs/notation.md``.
"""

from functools import cache
from typing import Any

import numpy as np
from scipy.optimize import brentq

from drapenet.result.estimate import Estimate, summary
from sim.cantilever.elastica import MAX_GAMMA, aspect_ratio, elastica
from sim.material import MICRO, torque
from sim.rig import GRAVITY

INCLINE = np.radians(41.5)  # of the plane that the strip's tip reaches
KES_CURVATURES = (50.0, 150.0)  # 1/m, of the secant
STANDARD_GRAVITY = 9.80665  # m/s², of gram-force
MG_CM = 1e-6 * STANDARD_GRAVITY * 1e-2  # N·m, of 1 mg·cm
GF_CM = 1e-3 * STANDARD_GRAVITY * 1e-2  # N·m, of 1 gf·cm²/cm
GF_CM_PER_CM = 1e-3 * STANDARD_GRAVITY  # N, of 1 gf·cm/cm
MAX_OUTSIDE_SHARE = 0.5  # of samples; beyond, B is not given
_SOFTENING = np.sinh(np.linspace(np.arcsinh(-4.0), np.arcsinh(10.0), 240))
_STEPS, _POINTS = 100, 11  # of the strips' integration: error below 1e-6


def bending_length(alpha: np.ndarray, beta: np.ndarray, density: float) -> np.ndarray:
    """Bending length, m: half the length of the strip whose tip reaches the plane at 41.5° (Peirce;
    ISO 9073-7, ASTM D1388 option A, FAST-2).

    Args:
        alpha, beta: of the same shape, N·m and N·m².
        density: kg/m².
    """
    natural = np.cbrt(alpha / (density * GRAVITY))
    return natural * np.interp(-beta / (alpha * natural), _SOFTENING, _lengths()) / 2


def flexural_rigidity(length: np.ndarray, density: float) -> np.ndarray:
    """G = rho g c³, N·m, of a bending length c, m, and a density rho, kg/m² (Peirce)."""
    return density * GRAVITY * length**3


def kes_bending(alpha: np.ndarray, beta: np.ndarray) -> np.ndarray:
    """B of KES-FB2, N·m: secant of the torque between 0.5 and 1.5 cm⁻¹, alpha + 200/m beta within
    the quadratic law. ``alpha``, N·m, and ``beta``, N·m², of the same shape.
    """
    low, high = (torque(np.asarray(at), alpha, beta) for at in KES_CURVATURES)
    return (high - low) / (KES_CURVATURES[1] - KES_CURVATURES[0])


def kes_hysteresis(alpha: np.ndarray, beta: np.ndarray) -> np.ndarray:
    """2HB of KES-FB2, N: twice the torque at zero curvature of the secant of :func:`kes_bending`,
    because KES's loading curve is B kappa + HB.

    ``alpha``, N·m, and ``beta``, N·m², of the same shape.
    """
    low = torque(np.asarray(KES_CURVATURES[0]), alpha, beta)
    return 2 * (low - KES_CURVATURES[0] * kes_bending(alpha, beta))


def outside_law(alpha: np.ndarray, beta: np.ndarray) -> np.ndarray:
    """Whether the torque alpha kappa + beta kappa² has its peak within KES's range, beyond which
    the moduli do not determine the reading. ``alpha``, N·m, and ``beta``, N·m², of the same shape.
    """
    return alpha + 2 * beta * KES_CURVATURES[1] < 0


def laboratory(estimate: Estimate) -> dict[str, dict[str, Any]]:
    """Medians and intervals of the testers' readings for an estimate, by direction."""
    alpha, beta = estimate.moduli(estimate.density)
    length = bending_length(alpha, beta, estimate.density)
    rigidity = flexural_rigidity(length, estimate.density)
    kes, two_hb = kes_bending(alpha, beta) / GF_CM, kes_hysteresis(alpha, beta) / GF_CM_PER_CM
    outside = outside_law(alpha, beta).mean(axis=0)
    return {name: {
        "bending_length_mm": summary(1e3 * length[:, k]),
        "flexural_rigidity_uN_m": summary(rigidity[:, k] / MICRO),
        "flexural_rigidity_mg_cm": summary(rigidity[:, k] / MG_CM),
        **{key: None if outside[k] > MAX_OUTSIDE_SHARE else summary(reading[:, k])
           for key, reading in (("kes_b_gf_cm2_per_cm", kes), ("kes_2hb_gf_cm_per_cm", two_hb))},
        "kes_b_outside_law_probability": round(float(outside[k]), 3),
    } for k, name in enumerate(estimate.names)}


@cache
def _lengths() -> np.ndarray:
    """Lengths of strips in units of l = (alpha/rho g)^(1/3) at -beta/(alpha l) = _SOFTENING."""
    return np.array([_length(softening) for softening in _SOFTENING])


def _length(softening: float) -> float:
    """Length, in units of (alpha/rho g)^(1/3), of a strip that ends on the plane."""

    def above(length: float) -> float:
        shape = elastica(length**3, _POINTS, softening=softening / length, steps=_STEPS)
        return aspect_ratio(shape[-1]) - np.tan(INCLINE)

    return brentq(above, 0.2, 0.99 * np.cbrt(MAX_GAMMA), xtol=1e-8)
