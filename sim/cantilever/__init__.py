"""Cantilever strips: the simulated tester, its theory, and the estimators that read its curves.

A strip of fabric is clamped at one end and hangs by its own weight (Feng et al. 2022, section
4.3). :mod:`elastica` solves the beam, :mod:`tester` simulates the cloth, :mod:`curves` reads and
smooths deflection curves, and :mod:`regression`, :mod:`table` and :mod:`fabric` turn curves into
moduli.
"""

from sim.cantilever.elastica import aspect_ratio, elastica, gamma_of_aspect_ratio, heavy_elastica
from sim.cantilever.tester import HungStrip, fabric_of_gamma, hang, hang_strip

__all__ = [
    "HungStrip",
    "aspect_ratio",
    "elastica",
    "fabric_of_gamma",
    "gamma_of_aspect_ratio",
    "hang",
    "hang_strip",
    "heavy_elastica",
]
