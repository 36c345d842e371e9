"""Refinement of an estimate by simulation.

``refined`` starts from an estimate; ``search`` solves :mod:`.problem` on a sequence of meshes and
springs.
"""
