"""Files in ``configs/``, read without Hydra, and their values in SI units."""

import math
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from types import GenericAlias
from typing import Annotated, Any, get_args, get_origin, get_type_hints

from pydantic import AfterValidator, Field

from common.documents import parse_yaml
from common.errors import InputError
from common.types import Metres

Workers = Annotated[int, Field(ge=1, le=1024)]
Seed = Annotated[int, Field(ge=0, lt=2**63)]
CONFIG_DIR = Path(__file__).resolve().parent.parent / "configs"
_UNITS: dict[str, Callable[[float], float]] = {
    "_mm": lambda value: 1e-3 * value,
    "_un": lambda value: 1e-6 * value,
    "_deg": math.radians,
    "_percent": lambda value: value / 100,
    "_n_per_m": float, "_per_m": float, "_px": lambda value: value,
}


def config_text(name: str, folder: Path | None = None) -> str:
    """The file ``NAME.yaml`` of a ``folder``, or else of ``configs``, with its comments."""
    for place in (folder or CONFIG_DIR, CONFIG_DIR):
        if (file := place / f"{name}.yaml").is_file():
            return file.read_text(encoding="utf-8")
    raise InputError(f"there are no settings {name}.yaml in {folder or CONFIG_DIR}")


def read_config(name: str, folder: Path | None = None) -> dict:
    """The content of :func:`config_text`."""
    return dict(parse_yaml(config_text(name, folder), f"configs/{name}.yaml"))


def group_options(group: str) -> list[str]:
    """Names of the options in ``configs/GROUP``."""
    return sorted(path.stem for path in (CONFIG_DIR / group).glob("*.yaml"))


def folder_of(group: str, name: str) -> str:
    """The folder of a group of ``configs/NAME.yaml``: in ``configs/NAME`` if it has the group."""
    return f"{name}/{group}" if group_options(f"{name}/{group}") else group


def read_option(group: str, name: str) -> dict:
    """The content of ``configs/GROUP/NAME.yaml``."""
    if name not in group_options(group):
        known = group.rpartition("/")[2]
        raise InputError(f"{known}={name} is unknown; known {known}s: "
                         f"{', '.join(group_options(group))}")
    return read_config(f"{group}/{name}")


def composed(name: str, chosen: dict[str, str], folder: Path | None = None) -> dict:
    """The content of ``NAME.yaml`` of a ``folder`` or of ``configs``, with the files and options of
    groups that its ``defaults`` list, as Hydra composes them (https://hydra.cc).

    Options that are ``chosen`` by group, which are taken out there, replace those listed.
    """
    content = read_config(name, folder)
    result: dict[str, Any] = {}
    content.pop("hydra", None)  # of sweeps
    for entry in content.pop("defaults", ["_self_"]):
        if entry == "_self_":
            merge(result, content)
        elif isinstance(entry, str):
            beside = "" if entry.startswith("/") else name.rpartition("/")[0]
            merge(result, composed(f"{beside}/{entry}".strip("/"), chosen, folder))
        else:
            ((group, default),) = entry.items()
            option = chosen.pop(group, default)
            if option not in (None, "null"):
                place = folder_of(group, name)
                if option not in group_options(place):
                    raise InputError(f"{group}={option} is unknown; give one of "
                                     f"{', '.join(group_options(place))}")
                part = composed(f"{place}/{option}", chosen)
                alone = _GLOBAL not in config_text(f"{place}/{option}")
                merge(result, {group: part} if alone else part)
    return result


_GLOBAL = "# @package _global_"  # of options whose keys are those of the command


def merge(settings: dict, others: Mapping) -> None:
    """Replace values in ``settings`` by ``others``, key by key."""
    for key, value in others.items():
        if isinstance(value, Mapping) and isinstance(settings.get(key), Mapping):
            settings[key] = dict(settings[key])
            merge(settings[key], value)
        else:
            settings[key] = value


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


@dataclass(frozen=True)
class Key:
    """How a file in ``configs/`` states a setting, in the annotation of its type in SI units."""

    unit: str  # the suffix of its key
    kind: Any  # its type there


def keys_of(settings: type, *, without: Collection[str] = ()) -> dict[str, Any]:
    """Types by key of the ``settings``, a dataclass in SI units, as a file states them; those
    without a :class:`Key` have the same name, and lists for tuples."""
    hints = get_type_hints(settings, include_extras=True)
    found = {}
    for name in [field.name for field in fields(settings) if field.name not in without]:
        hint = hints[name]
        keys = [mark for mark in getattr(hint, "__metadata__", ()) if isinstance(mark, Key)]
        if keys:
            found[f"{name}_{keys[0].unit}".rstrip("_")] = keys[0].kind
        else:
            found[name] = (GenericAlias(list, get_args(hint)[0]) if get_origin(hint) is tuple
                           else hint)
    return found


def up_to(most: float) -> Any:
    """Type of a number from 0 to ``most``."""
    return Annotated[float, Field(ge=0, le=most)]


def pair(kind: Any) -> Any:
    """Type of two values of a type."""
    return Annotated[GenericAlias(list, (kind,)), Field(min_length=2, max_length=2)]


Share = Annotated[float, Field(ge=0, le=1)]


def limits(least: float, most: float) -> Any:
    """Type of a smaller and a larger number between ``least`` and ``most``."""
    return Annotated[pair(Annotated[float, Field(ge=least, le=most)]), AfterValidator(_in_order)]


def _in_order(pair: list[float]) -> list[float]:
    if pair[0] > pair[1]:
        raise ValueError(f"from {pair[0]:g} to {pair[1]:g}: the smaller one first")
    return pair
