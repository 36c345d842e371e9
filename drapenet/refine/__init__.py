"""Refinement of an estimate by simulation."""
