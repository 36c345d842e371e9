"""Properties of the cloth itself that a laboratory, a supplier or a simulator's kit states.

No source states the curvature at which the kits of CLO and Browzwear bend cloth: the stiffness in a
drape is taken, and for CLO, whose hinges buckle beyond it, that at half of its curvature, as files
for it have. Over the fabrics of the prior secants from 20 to 150 1/m differ by 17 % (rms).
"""

import numpy as np

from common.types import Density
from data.fabrics.fabrics import ClothProperties
from data.readings.quantity import Quantity, moduli_at
from sim.material import DRAPE_CURVATURE, FIRST, MICRO, REFERENCE_DENSITY, SECOND, secant

CLO, BROWZWEAR = 1e9, 1e7  # g·mm²/s² and dyn·cm per N·m
MAX_CLO = 2e6  # g·mm²/s²


def _membrane(cloth: ClothProperties, density: Density) -> np.ndarray:
    return (cloth.membrane * density / REFERENCE_DENSITY)[:, None]


def _hysteresis(cloth: ClothProperties, density: Density) -> np.ndarray:
    return cloth.hysteresis[:, None]


def _stiffness(cloth: ClothProperties, density: Density) -> np.ndarray:
    alpha, _ = moduli_at(cloth, density)
    return np.sqrt(alpha[:, [FIRST]] * alpha[:, [SECOND]]) / MICRO


def _by_clo(cloth: ClothProperties, density: Density) -> np.ndarray:
    return CLO * secant(DRAPE_CURVATURE / 2, *moduli_at(cloth, density))


def _by_browzwear(cloth: ClothProperties, density: Density) -> np.ndarray:
    return BROWZWEAR * secant(DRAPE_CURVATURE, *moduli_at(cloth, density))


QUANTITIES = (
    Quantity("membrane_n_per_m", 1, 0.20, _membrane, "membrane stiffness [N/m]",
             limits=(10.0, 1e5)),
    Quantity("hysteresis_share", 1, 0.20, _hysteresis, "hysteresis, share of the torque [0 to 1]",
             limits=(1e-3, 1.0)),
    # Of an unknown test, curvature and specimen, as in a supplier's data sheet.
    Quantity("bending_stiffness_uN_m", 1, 0.35, _stiffness,
             "bending stiffness by the supplier [µN·m]", limits=(0.05, 2e4)),
    # Assumed: the curvature, and the scatter of specimens.
    Quantity("clo_bending_g_mm2_per_s2", 3, 0.20, _by_clo, "bending by CLO's kit [g·mm²/s²]",
             limits=(101.0, MAX_CLO)),  # its slider has 0 to 100
    Quantity("browzwear_bend_dyn_cm", 3, 0.20, _by_browzwear, "bend by Browzwear's FAB [dyn·cm]",
             limits=(0.5, 2e5)),
)
