"""Cantilever strips: the simulated tester, its theory, and the estimators that read its curves.

A strip of fabric is clamped at one end and hangs by its own weight (Feng et al. 2022, section
4.3). A deflection curve is an array (N, 2) of reach and drop in metres, from the clamp's edge to
the free end; the drop is positive downwards.
"""

from sim.cantilever.elastica import aspect_ratio, elastica, gamma_of_aspect_ratio, heavy_elastica
from sim.cantilever.tester import fabric_of_gamma, hang

__all__ = ["aspect_ratio", "elastica", "fabric_of_gamma", "gamma_of_aspect_ratio", "hang",
           "heavy_elastica"]
