"""Conversion of configuration values to SI units; the unit is the suffix of a key's name."""

import math
from collections.abc import Callable, Mapping

_UNITS: dict[str, Callable[[float], float]] = {
    "_mm": lambda value: 1e-3 * value,
    "_un": lambda value: 1e-6 * value,
    "_deg": math.radians,
    "_percent": lambda value: value / 100,
    "_n_per_m": float, "_per_m": float, "_px": lambda value: value,
}


def si(settings: Mapping[str, object]) -> dict:
    """Convert ``settings`` to SI units and radians, without unit suffixes; lists become tuples.

    ``{"pitch_deg": [0, 180], "seed": 3}`` gives ``{"pitch": (0.0, 3.14...), "seed": 3}``.

    Raises:
        TypeError: the key has a unit but the value is not a number.
    """
    found = {}
    for key, value in settings.items():
        unit = next((unit for unit in _UNITS if key.endswith(unit)), "")
        convert = _UNITS.get(unit, lambda value: value)
        found[key.removesuffix(unit)] = (
            tuple(map(convert, value)) if isinstance(value, list | tuple) else convert(value))
    return found
