"""Readings of laboratory testers: what they would measure of a fabric.

A laboratory that measures a value of its own kind writes a module like :mod:`data.readings.cloth`
with a :class:`~data.readings.quantity.Quantity` (key, error, value of a given cloth), and adds its
``QUANTITIES`` to the line below. The key is then read from ``known`` in ``capture.yaml`` and
``strips.yaml``, checked, combined with all other evidence, and named if it contradicts it.
"""

from data.readings import cantilever, cloth, kes

QUANTITIES = {each.name: each for module in (cantilever, kes, cloth) for each in module.QUANTITIES}
"""All quantities that may be known of a fabric, by key."""
