"""Replication of experiments of the papers: ``python -m studies NAME``; see docs/studies.md."""
