"""Figures of the documentation from the reports: ``python -m experiments.figures``.

In README.md and docs/*.md, the text between ``<!-- figures: NAME -->`` and ``<!-- end -->`` is
replaced by the block NAME of :mod:`experiments.figures.pages`, made from
docs/validation/*.json. A test compares pages and reports; ``make docs`` updates the pages. An
experiment prints its claims and its block.
"""
