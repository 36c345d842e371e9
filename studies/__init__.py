"""Experiments of the papers, repeated: ``python -m studies NAME``; see docs/studies.md."""
