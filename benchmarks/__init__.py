"""Claims of docs/validation.md, each measured by a command; figures are written by figures.py."""
