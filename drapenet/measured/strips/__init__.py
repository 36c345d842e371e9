"""Photographs of cantilever strips from the side, read as deflection curves."""
