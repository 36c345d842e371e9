"""Sparse symmetric systems: assembly into a fixed pattern, and direct solvers."""

from sim.solver.linear.pattern import SparsePattern
from sim.solver.linear.solvers import CholeskySolver, available_solvers, make_solver

__all__ = ["CholeskySolver", "SparsePattern", "available_solvers", "make_solver"]
