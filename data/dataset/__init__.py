"""Datasets of simulated drapes."""
