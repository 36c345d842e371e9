"""Moduli of the hinge law in the conventions of other simulators.

All of them say that a hinge with the dihedral angle theta and the rest edge e carries the torque

    tau = (a c + b c²) e,

and have their own curvature c. Here (Feng et al. 2022, section 4.2.1) it is
kappa = 2 theta / (H0 + H1) with the rest heights H of the two triangles. In another convention
c = f kappa, so that equal torques need a = alpha / f and b = beta / f²:

=================  =======================  ===  ===========  ============
convention         its curvature c          f    a            b
=================  =======================  ===  ===========  ============
ARCSim             theta / (2 (H0 + H1))    1/4  4 alpha      16 beta
discrete shells    6 theta / (H0 + H1)      3    alpha / 3    beta / 9
=================  =======================  ===  ===========  ============

*ARCSim* (Narain et al. 2012) has the energy k e² theta² / (8 A) of a hinge whose two triangles have
the area A = e (H0 + H1)/2: torque k kappa e / 4. Its k may come from a table over kappa; in the
table's terms the law above is k(kappa) = 4 (alpha + beta kappa).

*Discrete shells* (Grinspun et al. 2003) divide theta by a third of the mean height, (H0 + H1)/6.
The conversion is for the energy a theta² e / (2 h), h = (H0 + H1)/6. Codes that leave the half out,
and take a theta² e / h, need half of a: alpha / 6.

The conversion is exact for the same mesh. It does not make a hinge's modulus a physical one:
see :mod:`sim.cantilever.equivalent`.
"""

from dataclasses import dataclass


@dataclass(frozen=True)
class Convention:
    """How another simulator, ``name``, counts a hinge's curvature: f in the table."""

    name: str
    curvature: float

    def from_here(self, alpha: float, beta: float = 0.0) -> tuple[float, float]:
        """Moduli a (N·m) and b (N·m²) of the convention for alpha (N·m) and beta (N·m²) here."""
        return alpha / self.curvature, beta / self.curvature**2


ARCSIM = Convention("ARCSim", 1 / 4)
DISCRETE_SHELLS = Convention("discrete shells", 3.0)


if __name__ == "__main__":  # a module to import: python -m prints its table
    print(__doc__)
