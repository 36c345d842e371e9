"""Fields of a form, and the descriptions that they make or complete: ``capture.yaml``,
``strips.yaml`` and ``tension.yaml``."""

import re
from collections.abc import Mapping
from contextlib import suppress
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
from drapenet.measured.strips.description import FILE as STRIPS
from drapenet.measured.strips.description import StripsDescription
from drapenet.measured.tension.description import FILE as TENSION
from drapenet.measured.tension.description import MAX_STRIPS, TensionDescription
from drapenet.service.limits import RequestError
from sim.material import DIRECTIONS

PLACES = {**{key: ("intrinsics", key) for key in INTRINSICS_KEYS},
          **{f"plate_{key}": ("outline", "plate_px", key) for key in PlateInPicture.model_fields},
          **{key: ("outline", key) for key in OutlineSource.model_fields if key != "plate_px"}}
"""Where capture.yaml has the fields of a form that are not at its top; a point in the name of
another field stands between its keys."""
LABELS = tuple(key for key in Labels.model_fields if key != "fabric")
"""Fields that a report shows; the label ``fabric`` is the name of the fabric."""
STRIP = "tension."
"""Beginning of the fields of strips under weights, after which follow number and key."""
STRIP_NUMBERS = ("width_mm", "gauge_mm", "load_g", "extension_mm", "clamped_mm")
TENSION_NUMBERS = ("clip_g", "extension_error_mm", "kes_g_gf_per_cm_deg",
                   "fast_eb5_percent", "fast_e100_warp_percent", "fast_e100_weft_percent")
TEXTS = ("turns_deg", "tester", "face", "mat", "ground", "arrow", "camera_height_mm",
         *OutlineSource.OF_TABLES, "refine", "fabric", "name", "notes", "label", *LABELS,
         *(f"{STRIP}0.{key}" for key in ("direction", "without", "with", "specimen")))
_ANY_DENSITY = "100"  # g/m², of which no outline depends
KNOWN, COEFFICIENT = "known.", "known.drape_coefficient_percent"
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


NUMBERS = ("density_g_m2", "warp_direction_deg", "depth_unit_m",
           *(key for key in PLACES if key not in TEXTS),
           *(field for each in QUANTITIES.values() for field in
             (*value_fields(each), error_field(each))),
           COEFFICIENT, f"{KNOWN}nodes", *(f"{STRIP}0.{key}" for key in STRIP_NUMBERS),
           *TENSION_NUMBERS)


def states_values(fields: Mapping[str, str]) -> bool:
    """Whether a form has known values."""
    return any(key.startswith(KNOWN) for key in fields)


def states_tension(fields: Mapping[str, str]) -> bool:
    """Whether a form has strips under weights, or the shear by a tester."""
    return any(key.startswith(STRIP) or key in TENSION_NUMBERS for key in fields)


def described_capture(document: bytes, fields: Mapping[str, str]) -> tuple[bytes, Description]:
    """The content of ``capture.yaml`` with the fields of a form, checked."""
    content = _completed(document, CAPTURE, fields)
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
    return Description.of(_completed(b"{}", "", {
        key: text for key, text in fields.items() if key in keys or key.startswith(KNOWN)}), "")


def described_strips(document: bytes, fields: Mapping[str, str]
                     ) -> tuple[dict[str, Any], StripsDescription]:
    """The content of ``strips.yaml`` with the fields of a form, checked."""
    content = _completed(document, STRIPS, fields)
    return content, StripsDescription.of(content, "")


def described_tension(document: bytes, fields: Mapping[str, str]
                      ) -> tuple[dict[str, Any], TensionDescription]:
    """The content of ``tension.yaml`` with the fields of a form, checked; strips are in one of
    them, as known values are."""
    content = _completed(document, TENSION, {key: text for key, text in fields.items()
                                             if not key.startswith(STRIP)})
    if strips := _strips_under_weights(fields):
        if content.get("tension"):
            raise InputError(f"tension is in {TENSION} and in the form; give the strips in one of "
                             "them")
        content["tension"] = strips
    return content, TensionDescription.of(content, "")


def _strips_under_weights(fields: Mapping[str, str]) -> list[dict[str, Any]]:
    """Entries of ``tension`` by fields such as tension.0.load_g, in the order of their numbers."""
    strips: dict[int, dict[str, Any]] = {}
    for key, text in fields.items():
        number, _, name = key.removeprefix(STRIP).partition(".")
        if not key.startswith(STRIP):
            continue
        if not (number.isdecimal() and int(number) < MAX_STRIPS and name):
            raise InputError(f"unknown key '{key}'; strips under weights have fields such as "
                             f"{STRIP}0.load_g, the number below {MAX_STRIPS}")
        strips.setdefault(int(number), {})[name] = (
            text if name in ("specimen", "without", "with") else _plain(text))
    return [strips[number] for number in sorted(strips)]


def _completed(document: bytes, file: str, fields: Mapping[str, str]) -> dict[str, Any]:
    """The content of a description, in which a form's fields replace values, but not known ones:
    nobody can say which of two measurements is right."""
    if len(document) > MAX_TEXT_BYTES:
        raise RequestError(413, f"{file} has {len(document)} bytes; at most {MAX_TEXT_BYTES}")
    content = dict(parse_yaml(decoded_text(document, file), file))
    if content.get("known") and states_values(fields):
        raise InputError(f"known is in {file} and in the form; give the values in one of them")
    if "density_g_m2" in fields:
        content.pop("weight_g", None)  # which stands for the density
    for key, text in fields.items():
        *groups, name = PLACES.get(key) or key.split(".")
        place = content
        for group in groups:
            stated = place.get(group)
            place[group] = dict(stated) if isinstance(stated, Mapping) else {}
            place = place[group]
        place[name] = _value(key, text)
    return content


def _value(field: str, text: str) -> Any:
    """What a field states, in YAML's types."""
    if field in LABELS:
        return text
    if field == "turns_deg":
        return [_plain(word) for word in re.split(r"[,;\s]+", text.strip("[] "))]
    return _plain(text)


def _plain(text: str) -> Any:
    """The number, also with a decimal comma, or true or false that a text states, or the text."""
    with suppress(ValueError):
        value = number(text)
        return int(value) if value.is_integer() else value
    return {"true": True, "false": False}.get(text, text)
