"""Refinement of photographs of known fabrics from above, as ``refine_views``."""

from experiments.estimation.refine_views import run as run
