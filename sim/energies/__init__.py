"""Energies of a cloth, one per file, all with the contract of :class:`sim.energies.base.Energy`.

The bending law (:mod:`sim.energies.bending_law`) says how torque follows curvature; mid-edge and
hinge bending apply it to a mesh.
"""

from sim.energies.base import Energy, check
from sim.energies.bending_variants import Hysteresis
from sim.energies.membrane import Corotational, OrthotropicStVK, StrainLaw
from sim.energies.midedge import MidEdgeBending

__all__ = ["Corotational", "Energy", "Hysteresis", "MidEdgeBending", "OrthotropicStVK", "StrainLaw",
           "check"]
