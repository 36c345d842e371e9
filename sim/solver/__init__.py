"""Minimisation of a sum of energies, and implicit time steps."""
