"""Properties of fabrics beside their moduli, as a network estimates them."""

from dataclasses import dataclass

import numpy as np

from common.types import Theta


@dataclass(frozen=True)
class ClothProperties:
    """Fabrics at 300 g/m².

    Attributes:
        curl: (..., 2) 1/m, natural curvature along warp and weft with the marked face up.
        membrane: (...,) N/m, stiffness along the yarns.
        hysteresis: (...,) share of the torque, :class:`sim.energies.bending_variants.Hysteresis`.
    """

    theta: Theta
    curl: np.ndarray
    membrane: np.ndarray
    hysteresis: np.ndarray

    def chosen(self, rows: np.ndarray) -> "ClothProperties":
        """The fabrics of ``rows``, indices or a mask."""
        return ClothProperties(*(part[rows] for part in vars(self).values()))
