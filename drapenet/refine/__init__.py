"""Refinement: the specimen that a capture shows, found by simulation.

``refined`` starts from an estimate; ``search`` runs :mod:`.problem` on meshes and springs.
"""
