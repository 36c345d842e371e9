"""Experiments behind docs/validation.md and docs/studies.md: ``python -m experiments NAME``."""
