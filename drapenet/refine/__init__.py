"""Refinement: moduli corrected until the simulated drape is like the captured one.

``problem`` puts together theta, the simulator and an ``objective``; ``optimisers`` work on it.
Objectives: ``registered`` (vertex positions), ``depth`` (four views), ``scan`` (distance to a cloud
of points, border and outline), ``descriptor`` (the spectrum of the folds, whatever their phase).
"""
