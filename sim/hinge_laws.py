"""Hinge bending laws by name, and their moduli in the conventions of other simulators.

In all of them a hinge with the dihedral angle theta and the rest edge e carries the torque

    tau = (a c + b c²) e,

but their definitions of the curvature c differ. Here (Feng et al. 2022, section 4.2.1) it is
kappa = 2 theta / (H0 + H1) with the rest heights H of the two triangles. In another convention
c = f kappa, so that equal torques need a = alpha / f and b = beta / f²:

=================  =======================  ===  ===========  ============
convention         curvature c              f    a            b
=================  =======================  ===  ===========  ============
ARCSim             theta / (2 (H0 + H1))    1/4  4 alpha      16 beta
discrete shells    6 theta / (H0 + H1)      3    alpha / 3    beta / 9
=================  =======================  ===  ===========  ============

*ARCSim* (Narain et al. 2012) has the energy k e² theta² / (8 A) of a hinge whose two triangles have
the area A = e (H0 + H1)/2: torque k kappa e / 4. Its k may come from a table over kappa; the
law above is then k(kappa) = 4 (alpha + beta kappa).

*Discrete shells* (Grinspun et al. 2003) divide theta by a third of the mean height, (H0 + H1)/6.
The conversion is for the energy a theta² e / (2 h), h = (H0 + H1)/6. Codes with the energy
a theta² e / h need half of a: alpha / 6.

The conversion is exact for the same mesh. It does not make a hinge modulus physical: see
:mod:`sim.cantilever.equivalent`.
"""

from dataclasses import dataclass

import numpy as np

from sim.energies.base import Energy
from sim.energies.hinges import DihedralBending, Hinges, QuadraticBending
from sim.material import BIAS, WARP, WEFT, Fabric
from sim.mesh import Mesh

FORMS = ("hinge", "hinge_linear", "quadratic")
WEIGHTINGS = ("mean", "edge")


@dataclass(frozen=True)
class HingeLaw:
    """A hinge law: the form of its energy and its dependence on the fabric's direction.

    Attributes:
        form: ``hinge`` (torque alpha kappa + beta kappa²), ``hinge_linear`` (beta = 0) or
            ``quadratic`` (gamma = alpha/3, beta = 0).
        direction: ``mean``: every hinge has the mean modulus over all directions; ``edge``: the
            modulus across its rest edge (Wang et al. 2011). The modulus along the curvature of an
            earlier solution (section 4.4) is omitted: its torque does not derive from an energy.
    """

    form: str = "hinge"
    direction: str = "mean"

    def __call__(self, mesh: Mesh, active: np.ndarray, *, fabric: Fabric) -> Energy:
        """The energy of the hinges of the triangles ``active`` (F,) bool of ``mesh``."""
        hinges = Hinges(mesh, active)
        x, y = hinges.normals.T
        alpha, beta = (
            np.full(len(x), mean_modulus(moduli)) if self.direction == "mean"
            else modulus_along(moduli, np.arctan2(y, x)) for moduli in (fabric.alpha, fabric.beta))
        if self.form == "quadratic":
            return QuadraticBending(hinges, gamma=alpha / 3)
        return DihedralBending(hinges, alpha=alpha, beta=beta * (self.form == "hinge"),
                               barrier_modulus=fabric.alpha.min())


HINGE_LAWS = {
    form if direction == "mean" else f"{form}_{direction}": HingeLaw(form, direction)
    for form in FORMS
    for direction in WEIGHTINGS
}
"""hinge, hinge_edge, hinge_linear, ..., quadratic_edge."""


def modulus_along(moduli: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Moduli in directions ``angle`` (rad from warp, any shape) of (warp, bias, weft) (3,), N·m or
    N·m².

    Feng et al. 2022, Eq. 7 and 8: between neighbouring sample directions the moduli are
    interpolated by cos² and sin²; warp and weft are symmetry axes. With c = cos 2 phi this is

        k = k_bias + max(c, 0) (k_warp - k_bias) + max(-c, 0) (k_weft - k_bias),

    a weighted mean of the three with non-negative weights, so that it never changes sign.
    """
    warp, bias, weft = moduli[WARP], moduli[BIAS], moduli[WEFT]
    c = np.cos(2 * np.asarray(angle, float))
    return bias + np.maximum(c, 0) * (warp - bias) + np.maximum(-c, 0) * (weft - bias)


def mean_modulus(moduli: np.ndarray) -> float:
    """Mean of :func:`modulus_along` over all directions: (1 - 2/pi) bias + (warp + weft)/pi.
    ``moduli`` (3,), N·m or N·m²."""
    return float((1 - 2 / np.pi) * moduli[BIAS] + (moduli[WARP] + moduli[WEFT]) / np.pi)


ARCSIM, DISCRETE_SHELLS = 1 / 4, 3.0
"""Factor f of the curvature in other simulators, see the table above."""
