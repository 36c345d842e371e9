"""Readings of the cantilever test (Peirce; ISO 9073-7, ASTM D1388 option A, FAST-2).

It measures the law over a range of curvatures, not alpha, so the test is simulated with the law of
each fabric. Constants of the standards' editions: ``docs/notation.md``.
"""

import json
from functools import cache
from pathlib import Path

import numpy as np

from common.types import Density
from data.fabrics.fabrics import ClothProperties
from data.readings.quantity import STANDARD_GRAVITY, Quantity, moduli_at
from sim.material import MICRO
from sim.rig import GRAVITY

MG_CM = 1e-6 * STANDARD_GRAVITY * 1e-2  # N·m, of 1 mg·cm
SOFTENING = np.sinh(np.linspace(np.arcsinh(-4.0), np.arcsinh(10.0), 240))
"""-beta/(alpha l) of the strips in ``data/weights/strips.json``, l = (alpha/rho g)^(1/3)."""


@cache
def strip_lengths() -> np.ndarray:
    """(240,) lengths, in units of l, of the strips of :data:`SOFTENING` that end on the plane.

    Heavy elasticas, integrated with errors below 1e-6: ``tests/data/test_readings.py``.
    """
    file = Path(__file__).parents[1] / "weights" / "strips.json"
    return np.array(json.loads(file.read_text(encoding="utf-8")))


def bending_length(alpha: np.ndarray, beta: np.ndarray, density: Density) -> np.ndarray:
    """Bending length, m, of moduli, N·m and N·m², of the same shape: half the length of the strip
    whose tip reaches the plane at 41.5°.
    """
    natural = np.cbrt(alpha / (density * GRAVITY))
    return natural * np.interp(-beta / (alpha * natural), SOFTENING, strip_lengths()) / 2


def flexural_rigidity(alpha: np.ndarray, beta: np.ndarray, density: Density) -> np.ndarray:
    """Flexural rigidity G, N·m, of the standards: rho g times the bending length's cube. Moduli,
    N·m and N·m², have the same shape."""
    return density * GRAVITY * bending_length(alpha, beta, density) ** 3


def _length_mm(cloth: ClothProperties, density: Density) -> np.ndarray:
    return 1e3 * bending_length(*moduli_at(cloth, density), density)


def _overhang_mm(cloth: ClothProperties, density: Density) -> np.ndarray:
    return 2 * _length_mm(cloth, density)


def _rigidity_micro(cloth: ClothProperties, density: Density) -> np.ndarray:
    return flexural_rigidity(*moduli_at(cloth, density), density) / MICRO


def _rigidity_mg_cm(cloth: ClothProperties, density: Density) -> np.ndarray:
    return MICRO / MG_CM * _rigidity_micro(cloth, density)


BENDING_LENGTHS = (5.0, 150.0)  # mm, that a laboratory may have read
# Assumed errors: the standards at hand state none.
QUANTITIES = (
    Quantity("bending_length_mm", 3, 0.05, _length_mm, "bending length [mm]",
             limits=BENDING_LENGTHS, doubled="the overhang, overhang_mm"),
    Quantity("overhang_mm", 3, 0.05, _overhang_mm, "overhang at 41.5° [mm]",
             limits=(10.0, 300.0)),
    Quantity("flexural_rigidity_uN_m", 3, 0.15, _rigidity_micro, "flexural rigidity G [µN·m]",
             limits=(0.05, 2e4)),
    Quantity("flexural_rigidity_mg_cm", 3, 0.15, _rigidity_mg_cm, "flexural rigidity G [mg·cm]",
             limits=(0.5, 2e5)),
)
