"""Synthetic depth images of drapes."""
