"""Readings of laboratory testers: what they would measure of a fabric.

A laboratory that measures a value of its own kind writes a module like :mod:`data.readings.cloth`,
with a tuple ``QUANTITIES`` of :class:`~data.readings.quantity.Quantity` (key, error, value of a
given cloth), and adds its name to :data:`MODULES`. The key is then read from ``known`` in
every description and on the page, checked, combined with all other evidence, and
named if it contradicts it. Maps for trainings, which depend on this code, are made again.
"""

from importlib import import_module

from data.readings.quantity import Quantity, by_name

__all__ = ["MODULES", "QUANTITIES", "Quantity"]

MODULES = ("cantilever", "kes", "cloth")
QUANTITIES: dict[str, Quantity] = by_name(
    each for name in MODULES for each in import_module(f"{__name__}.{name}").QUANTITIES)
"""All quantities that may be known of a fabric, by key."""
