"""Properties of the cloth itself that a laboratory or a supplier states."""

import numpy as np

from common.types import Density
from data.fabrics.fabrics import ClothProperties
from data.readings.quantity import Quantity, moduli_at
from sim.material import FIRST, MICRO, REFERENCE_DENSITY, SECOND


def _membrane(cloth: ClothProperties, density: Density) -> np.ndarray:
    return (cloth.membrane * density / REFERENCE_DENSITY)[:, None]


def _hysteresis(cloth: ClothProperties, density: Density) -> np.ndarray:
    return cloth.hysteresis[:, None]


def _stiffness(cloth: ClothProperties, density: Density) -> np.ndarray:
    alpha, _ = moduli_at(cloth, density)
    return np.sqrt(alpha[:, [FIRST]] * alpha[:, [SECOND]]) / MICRO


QUANTITIES = (
    Quantity("membrane_n_per_m", 1, 0.20, _membrane, "membrane stiffness [N/m]",
             limits=(10.0, 1e5)),
    Quantity("hysteresis_share", 1, 0.20, _hysteresis, "hysteresis, share of the torque [0 to 1]",
             limits=(1e-3, 1.0)),
    # Of an unknown test, curvature and specimen, as in a supplier's data sheet.
    Quantity("bending_stiffness_uN_m", 1, 0.35, _stiffness,
             "bending stiffness by the supplier [µN·m]", limits=(0.05, 2e4)),
)
