"""Estimates of many captures."""
