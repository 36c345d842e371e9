"""Energies of a cloth, one per file, all with the contract of :class:`sim.energies.base.Energy`.

The bending law (:mod:`sim.energies.bending_law`) says how torque follows curvature; mid-edge and
hinge bending apply it to a mesh.
"""
