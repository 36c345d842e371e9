"""Experiments of published papers, repeated: docs/studies.md."""
