"""Replications of published experiments: ``python -m studies NAME``; see docs/studies.md."""
