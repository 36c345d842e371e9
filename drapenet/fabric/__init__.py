"""The estimate of a fabric: read, observe, infer, combine, describe, a module each.

:mod:`drapenet.fabric.estimate` calls them in this order, for the command, batches, the service
and Python; :mod:`drapenet.fabric.stages` refines, simulates and reports a capture's estimate.
"""
