"""Energies of a cloth, one per file, all with the contract of :class:`sim.energies.base.Energy`."""
