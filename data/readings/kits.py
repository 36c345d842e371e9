"""Readings of the kits of CLO and Browzwear: the one stiffness that their simulators take.

No source states the curvature at which a kit bends cloth: the stiffness in a drape is taken
(``docs/exports.md``). Over the fabrics of the prior secants from 20 to 150 1/m differ from it by
17 % (rms).
"""

from collections.abc import Callable

import numpy as np

from common.types import Density
from data.fabrics.fabrics import ClothProperties
from data.readings.quantity import Quantity, moduli_at
from sim.material import DRAPE_CURVATURE, secant

CLO, BROWZWEAR = 1e9, 1e7  # g·mm²/s² and dyn·cm per N·m
MAX_CLO = 2e6  # g·mm²/s²
_ERROR = 0.20  # assumed: curvature, and scatter of specimens


def _in_a_drape(unit: float) -> Callable[[ClothProperties, Density], np.ndarray]:
    return lambda cloth, density: unit * secant(DRAPE_CURVATURE, *moduli_at(cloth, density))


QUANTITIES = (
    Quantity("clo_bending_g_mm2_per_s2", 3, _ERROR, _in_a_drape(CLO),
             "bending of CLO's kit [g·mm²/s²]", limits=(50.0, MAX_CLO)),
    Quantity("browzwear_bend_dyn_cm", 3, _ERROR, _in_a_drape(BROWZWEAR),
             "bend of Browzwear's FAB [dyn·cm]", limits=(0.5, 2e5)))
