"""Distributions of fabrics and of the nuisances of their specimens."""
