"""Files in ``configs/``, read without Hydra, and their values in SI units."""

import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Any

from pydantic import AfterValidator, Field

from common.documents import parse_yaml
from common.errors import InputError
from common.types import Metres

CONFIG_DIR = Path(__file__).resolve().parent.parent / "configs"
_UNITS: dict[str, Callable[[float], float]] = {
    "_mm": lambda value: 1e-3 * value,
    "_un": lambda value: 1e-6 * value,
    "_deg": math.radians,
    "_percent": lambda value: value / 100,
    "_n_per_m": float, "_per_m": float, "_px": lambda value: value,
}


def config_text(name: str) -> str:
    """The file ``configs/NAME.yaml``, with its comments."""
    return (CONFIG_DIR / f"{name}.yaml").read_text(encoding="utf-8")


def read_config(name: str) -> dict:
    """The content of ``configs/NAME.yaml``."""
    return dict(parse_yaml(config_text(name), f"configs/{name}.yaml"))


def group_options(group: str) -> list[str]:
    """Names of the options in ``configs/GROUP``."""
    return sorted(path.stem for path in (CONFIG_DIR / group).glob("*.yaml"))


def read_option(group: str, name: str) -> dict:
    """The content of ``configs/GROUP/NAME.yaml``."""
    if name not in group_options(group):
        raise InputError(f"unknown {group} {name!r}; known {group}s: "
                         f"{', '.join(group_options(group))}")
    return read_config(f"{group}/{name}")


def metres(millimetres: float | None) -> Metres | None:
    """The length of a key ``_mm``; null, for a default or nothing, remains None."""
    return None if millimetres is None else 1e-3 * millimetres


def si(settings: Mapping[str, object]) -> dict:
    """Settings in SI units and radians, without the suffixes of units; lists become tuples.

    ``{"pitch_deg": [0, 180], "seed": 3}`` gives ``{"pitch": (0.0, 3.14...), "seed": 3}``.
    """
    converted = {}
    for key, value in settings.items():
        unit = next((unit for unit in _UNITS if key.endswith(unit)), "")
        convert = _UNITS.get(unit, lambda value: value)
        converted[key.removesuffix(unit)] = (
            tuple(map(convert, value)) if isinstance(value, list | tuple) else convert(value))
    return converted


def limits(least: float, most: float) -> Any:
    """Type of a smaller and a larger number between ``least`` and ``most``."""
    return Annotated[list[Annotated[float, Field(ge=least, le=most)]],
                     Field(min_length=2, max_length=2), AfterValidator(_in_order)]


def _in_order(pair: list[float]) -> list[float]:
    if pair[0] > pair[1]:
        raise ValueError(f"from {pair[0]:g} to {pair[1]:g}: the smaller one first")
    return pair
