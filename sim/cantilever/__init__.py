"""Cantilever strips: simulated tester, theory, and estimation of moduli from deflection curves.

A strip of fabric is clamped at one end and bends under its weight (Feng et al. 2022, section 4.3).
Throughout, a deflection curve leads from the clamp's edge to the free end, the drop positive
downwards; ``weight`` is rho g in N/m² and ``slope`` the angle of the clamp below the horizontal.
"""

from sim.cantilever.elastica import aspect_ratio, elastica, gamma_of_aspect_ratio, heavy_elastica
from sim.cantilever.strip import fabric_of_gamma, hang

__all__ = ["aspect_ratio", "elastica", "fabric_of_gamma", "gamma_of_aspect_ratio", "hang",
           "heavy_elastica"]
