"""Strips of cloth stretched by weights: what they say of stretch and shear."""
