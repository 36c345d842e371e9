"""Replications of published experiments: ``python -m experiments.papers NAME``; see
docs/studies.md."""
