"""Orthotropic St. Venant-Kirchhoff elasticity: stress linear in the Green strain."""

import numpy as np


class OrthotropicLaw:
    """Linear elasticity with Young's moduli along warp and weft (Larionov et al., Eq. 6).

    S_uu = (E_warp e_uu + n E_weft e_vv)/d, S_vv = (n E_weft e_uu + E_weft e_vv)/d,
    S_uv = shear 2 e_uv, with d = 1 - n² E_weft/E_warp and n the Poisson's ratio below.

    Args:
        warp, weft: Young's moduli times thickness, N/m.
        poisson: contraction along weft over extension along warp when pulled along warp.
        shear: shear modulus times thickness, N/m.
    """

    def __init__(self, *, warp: float, weft: float, poisson: float, shear: float) -> None:
        d = 1 - poisson**2 * weft / warp
        coupling = poisson * weft / d
        self.stiffness = np.array(
            [[warp / d, coupling, 0.0], [coupling, weft / d, 0.0], [0.0, 0.0, shear]]
        )

    def energy(self, strain: np.ndarray) -> np.ndarray:
        return 0.5 * np.einsum("ni,ni->n", strain, self.stress(strain))

    def stress(self, strain: np.ndarray) -> np.ndarray:
        return strain @ self.stiffness

    def tangent(self, strain: np.ndarray) -> np.ndarray:
        return np.broadcast_to(self.stiffness, (len(strain), 3, 3))
