"""The network that reads bending moduli from four depth images of a drape."""
