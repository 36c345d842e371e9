"""Quasi-static cloth simulation of the drape test: physics only, no images, no networks."""

from sim.kernel_cache import ensure_kernel_cache

ensure_kernel_cache()
