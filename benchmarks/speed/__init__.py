"""Timings of drapes, views and the service."""
