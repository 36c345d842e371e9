"""Quasi-static cloth simulation of the drape test: physics only, no images, no networks."""
