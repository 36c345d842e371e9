"""Simulated cloth laid on captured surfaces, and registration of scans with it."""
