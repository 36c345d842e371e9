"""Verification and statistics of datasets of drapes."""
