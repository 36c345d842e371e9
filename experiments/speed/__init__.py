"""Timings of drapes and views, and load tests of the service."""
