"""Estimation of bending moduli from depth images of a drape."""
