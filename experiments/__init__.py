"""Benchmarks behind docs/validation.md, one command each; figures.py writes the documentation."""
