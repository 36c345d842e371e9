"""Minimisation of a sum of energies, and implicit time steps."""

from sim.solver.newton import NewtonOptions, NewtonResult, Status, minimise
from sim.solver.state import State

__all__ = ["NewtonOptions", "NewtonResult", "State", "Status", "minimise"]
