"""Fields of a form, which are those of the descriptions of all kinds of measurements, and the
descriptions that they make or complete: ``capture.yaml``, ``strips.yaml`` and so on."""

import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from functools import lru_cache
from typing import Annotated, Any

from pydantic import Field

from common.documents import MAX_TEXT_BYTES, Schema, decoded_text, parse_yaml, yaml_text
from common.errors import InputError
from common.tables import number
from data.captures.description import (
    INTRINSICS_KEYS,
    MAX_LABEL_LENGTH,
    PRINTABLE,
    Description,
    Labels,
    OutlineSource,
    PlateInPicture,
    Specimen,
)
from data.captures.reader import DESCRIPTION as CAPTURE
from data.readings import QUANTITIES
from data.readings.quantity import Quantity
from data.rigs import MISSING_TESTER
from drapenet.measured import KINDS, VALUES
from drapenet.measured.base import Described, Measured, kind_at
from drapenet.service.limits import RequestError
from sim.material import DIRECTIONS

PLACES = {**{key: ("intrinsics", key) for key in INTRINSICS_KEYS},
          **{f"plate_{key}": ("outline", "plate_px", key) for key in PlateInPicture.model_fields},
          **{key: ("outline", key) for key in OutlineSource.model_fields if key != "plate_px"}}
"""Where capture.yaml has the fields of a form that are not at its top; a point in the name of
another field stands between its keys."""
_SHORT = {".".join(place): field for field, place in PLACES.items()}
_ANY_DENSITY = "100"  # g/m², of which no outline depends
KNOWN = "known."
_ERROR = f"{KNOWN}error_percent."


class About(Schema):
    """What a user states of a fabric: ``name``, ``notes``; and the ``label`` of its capture."""

    name: str = Field("", max_length=MAX_LABEL_LENGTH, pattern=PRINTABLE,
                      description=f"up to {MAX_LABEL_LENGTH} printable characters")
    notes: Annotated[str, Field(max_length=2000)] = ""
    label: str = Field("", max_length=40, pattern=PRINTABLE,
                       description="up to 40 printable characters")


def value_fields(quantity: Quantity) -> list[str]:
    """Fields of the known values of a quantity: along warp, bias and weft, or one."""
    name = f"{KNOWN}{quantity.name}"
    return [f"{name}.{key}" for key in DIRECTIONS] if quantity.directions > 1 else [name]


def error_field(quantity: Quantity) -> str:
    """Field of the relative error, %, of the known values of a quantity."""
    return f"{_ERROR}{quantity.name}"


@lru_cache
def fields_of(schema: type[Schema]) -> dict[str, str]:
    """Fields of a form for a description, dotted, with their types in JSON, "" for several; of a
    list of entries those of its first one."""
    content = schema.model_json_schema()
    found: dict[str, str] = {}

    def walk(part: dict[str, Any], name: str) -> None:
        if "$ref" in part:
            part = content["$defs"][part["$ref"].rpartition("/")[2]]
        options = [option for option in part.get("anyOf", ()) if option.get("type") != "null"]
        if len(options) == 1:
            walk(options[0], name)
        elif "properties" in part:
            for key, inner in part["properties"].items():
                walk(inner, f"{name}.{key}".lstrip("."))
        elif "$ref" in part.get("items", ()):
            walk(part["items"], f"{name}.0")
        else:
            found[name] = part.get("type", "")

    walk(content, "")
    return found


def form_fields() -> dict[str, str]:
    """All fields of a form with their types in JSON, numbers or texts."""
    schemas = [*(kind_at(place).schema for place in KINDS.values()), About]
    found = {_SHORT.get(key, key): kind for schema in schemas
             for key, kind in fields_of(schema).items() if kind != "object"}
    found |= dict.fromkeys(map(error_field, QUANTITIES.values()), "number")
    return {key: "number" if kind in ("number", "integer") else "string"
            for key, kind in (found | {"fabric": "string"}).items()}


def typed_kinds() -> list[tuple[type[Measured], dict[str, str], int]]:
    """The kinds whose numbers the page asks for, with title by field of those that no capture has,
    and how many specimens they may have."""
    found = []
    for kind in dict.fromkeys(map(kind_at, KINDS.values())):
        if not (issubclass(kind.schema, Described) and kind.schema.typed):
            continue
        fields = {name: field.title or name for name, field in kind.schema.model_fields.items()
                  if name not in Description.model_fields}
        found.append((kind, fields, _most_entries(kind.schema, kind.schema.entries)))
    return found


def states_values(fields: Mapping[str, str]) -> bool:
    """Whether a form has known values."""
    return any(key.startswith(KNOWN) for key in fields)


def kinds_stated(fields: Mapping[str, str], *, alone: bool = False) -> list[str]:
    """Files of the kinds of which a form has fields that no capture has; that of values if none of
    them has all fields of a form ``alone``, without files, and values have."""
    every = {key.partition(".")[0] for key in fields}
    own = every - {*Description.model_fields, *PLACES}
    keys = {file: kind_at(place).schema.model_fields.keys() for file, place in KINDS.items()}
    found = [file for file in keys if file != VALUES and own & keys[file]]
    whole = any(every <= keys[file] for file in found)
    return [VALUES] if alone and not whole and every <= keys[VALUES] else found


def described_capture(document: bytes, fields: Mapping[str, str]) -> tuple[bytes, Description]:
    """The content of ``capture.yaml`` with the fields of a form, checked."""
    content = _completed(document, CAPTURE, fields, kind_at(KINDS[CAPTURE]))
    description = Description.of(content, "")
    if description.tester is None:
        raise RequestError(422, f"tester is missing; {MISSING_TESTER}")
    return yaml_text(content).encode(), description


def states_plate(fields: Mapping[str, str]) -> bool:
    """Whether a form says where the plate is in a photograph."""
    return any(PLACES.get(key, ())[:2] == ("outline", "plate_px") for key in fields)


def fields_of_outline(fields: Mapping[str, str]) -> dict[str, str]:
    """The fields that change how an outline is read, with any density."""
    return {"density_g_m2": _ANY_DENSITY} | {
        key: text for key, text in fields.items()
        if key in ("tester", "warp_direction_deg") or PLACES.get(key, ("",))[0] == "outline"}


def described_scan(fields: Mapping[str, str]) -> Description:
    """What a form states of a scan; fields of testers and cameras are not read."""
    keys = {*Specimen.model_fields, *Labels.model_fields}
    stated = {key: text for key, text in fields.items() if key in keys or key.startswith(KNOWN)}
    return Description.of(_completed(b"{}", "", stated, kind_at(KINDS[CAPTURE])), "")


def described(document: bytes, file: str, fields: Mapping[str, str]
              ) -> tuple[dict[str, Any], Described]:
    """The content of the description ``file`` of a kind with the fields of a form, checked."""
    kind: Any = kind_at(KINDS[file])
    content = _completed(document, file, fields, kind)
    return content, kind.schema.of(content, "")


def _completed(
    document: bytes, file: str, fields: Mapping[str, str], kind: type[Measured]
) -> dict[str, Any]:
    """The content of a description, in which a form's fields replace values, but neither known ones
    nor entries of a list: nobody can say which of two measurements is right."""
    if len(document) > MAX_TEXT_BYTES:
        raise RequestError(413, f"{file} has {len(document)} bytes; at most {MAX_TEXT_BYTES}")
    content = dict(parse_yaml(decoded_text(document, file), file))
    if content.get("known") and states_values(fields):
        raise InputError(f"known is in {file} and in the form; give the values in one of them")
    if "density_g_m2" in fields:
        content.pop("weight_g", None)  # which stands for the density
    entries: dict[str, dict[int, dict[str, Any]]] = {}
    for key, text in fields.items():
        path = key.split(".")
        if path[0] not in kind.schema.model_fields:
            path = [*PLACES.get(key, path)]
        name = ".".join("0" if part.isdecimal() else part for part in path)
        value = _value(text, fields_of(kind.schema).get(name, ""))
        if most := _most_entries(kind.schema, path[0]):
            if not (len(path) > 2 and path[1].isdecimal() and int(path[1]) < most):
                raise InputError(f"unknown key '{key}'; {kind.noun} have fields such as "
                                 f"{path[0]}.0.direction, the number below {most}")
            _put(entries.setdefault(path[0], {}).setdefault(int(path[1]), {}), path[2:], value)
        else:
            _put(content, path, value)
    for name, numbered in entries.items():
        if content.get(name):
            raise InputError(f"{name} is in {file} and in the form; give the strips in one of them")
        content[name] = [numbered[number] for number in sorted(numbered)]
    return content


def _most_entries(schema: type[Schema], key: str) -> int:
    """How many entries the list ``key`` of a description has at most; 0 if it is none."""
    stated = schema.model_json_schema()["properties"].get(key, {})
    return stated.get("maxItems", 0) if "$ref" in stated.get("items", ()) else 0


def _put(content: dict[str, Any], path: Sequence[str], value: Any) -> None:
    """Put a value at the end of a path of keys."""
    *groups, name = path
    for group in groups:
        stated = content.get(group)
        content[group] = dict(stated) if isinstance(stated, Mapping) else {}
        content = content[group]
    content[name] = value


def _value(text: str, kind: str) -> Any:
    """What a field of a type in JSON states, in YAML's types."""
    if kind == "string":
        return text
    if kind == "array":
        return [_plain(word) for word in re.split(r"[,;\s]+", text.strip("[] "))]
    return _plain(text)


def _plain(text: str) -> Any:
    """The number, also with a decimal comma, or true or false that a text states, or the text."""
    with suppress(ValueError):
        value = number(text)
        return int(value) if value.is_integer() else value
    return {"true": True, "false": False}.get(text, text)
