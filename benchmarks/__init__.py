"""Timings, printed as JSON with the hardware and versions they were taken on."""
