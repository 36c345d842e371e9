"""The testers that captures may be of: names and numbers, with their limits."""

from collections.abc import Mapping
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, PlainValidator

from common.documents import Schema
from common.errors import InputError
from sim.rig import RIGS, Rig

DIAMETERS, SIDES, PLATES = (200.0, 400.0), (140.0, 400.0), (60.0, 200.0)  # mm; of discs, rectangles
MAX_RIM = 10.0  # mm, radius of the rounded rim of a plate
MIN_OVERHANG = 20.0  # mm, on every side
TESTERS = tuple(name for name, rig in RIGS.items() if rig.has_plate)
"""Abbreviations of common testers."""
EXAMPLE = "{specimen: disc, size_mm: 254, plate_mm: 127}"
_CHOICES = f"{', '.join(TESTERS)}, or numbers such as {EXAMPLE}"
MISSING_TESTER = f"give tester: {_CHOICES}"
"""Remedy for a capture without tester."""


class _Numbers(Schema):
    specimen: Literal["square", "rectangle", "disc"]
    size_mm: float
    plate_mm: float
    rim_radius_mm: float = 0.0


class _Sides(_Numbers):
    size_mm: Annotated[list[float], Field(  # type: ignore[assignment]
        min_length=2, max_length=2,
        description="give both sides of a rectangle, along warp and weft, such as [170, 250]")]


def read_tester(value: object) -> Rig:
    """The tester that a document states: the name of a rig, or a mapping as :data:`EXAMPLE`, also
    with the radius of the plate's rounded rim, which is not known if it is 0.

    The message of an InputError continues a sentence that begins with the value.
    """
    try:
        if isinstance(value, Mapping):
            schema = _Sides if value.get("specimen") == "rectangle" else _Numbers
            numbers = schema.of(value, "")
            sides = tuple(np.broadcast_to(numbers.size_mm, 2) / 1e3)
            rig = Rig(sides, numbers.plate_mm / 1e3, numbers.specimen,
                      rim=numbers.rim_radius_mm / 1e3)
        else:
            rig = Rig.from_name(value if isinstance(value, str) else "")
    except InputError as error:
        reason = f" ({error})" if isinstance(value, Mapping) else ""
        raise InputError(f"is not a tester{reason}; give {_CHOICES}") from None
    sizes = DIAMETERS if rig.specimen == "disc" else SIDES
    for what, lengths, text, (low, high) in (
            ("specimen", rig.sides, rig.millimetres, sizes),
            ("plate", [rig.plate_diameter], f"{1e3 * rig.plate_diameter:g}", PLATES),
            ("rim", [rig.rim], f"{1e3 * rig.rim:g}", (0.0, MAX_RIM))):
        if not all(low <= round(1e3 * length, 6) <= high for length in lengths):
            raise InputError(f"has a {what} of {text} mm; give {low:g} to {high:g} mm")
    if (overhang := round(1e3 * rig.least_overhang, 6)) < MIN_OVERHANG:
        raise InputError(f"has an overhang of {overhang:g} mm; give {MIN_OVERHANG:g} mm or more: a "
                         "larger specimen, or a smaller plate")
    if rig.cut:
        raise InputError("has a specimen that is cut at an angle to the yarns; cut it along them")
    return rig


Tester = Annotated[Rig, PlainValidator(read_tester)]
"""Type of a schema's field that states a tester."""


def named_tester(name: str) -> Rig:
    """The tester called ``name``; InputError, a whole sentence, if there is none."""
    try:
        return read_tester(name)
    except InputError as error:
        raise InputError(f"tester={name} {error}") from None


def described_tester(rig: Rig) -> str | dict[str, str | float | list[float]]:
    """The value that :func:`read_tester` reads as ``rig``, in JSON types."""
    if rig.name in TESTERS:
        return rig.name
    sides = [round(1e3 * side, 6) for side in rig.sides]
    return {"specimen": rig.specimen, "size_mm": sides if rig.specimen == "rectangle" else sides[0],
            "plate_mm": round(1e3 * rig.plate_diameter, 6),
            **({"rim_radius_mm": round(1e3 * rig.rim, 6)} if rig.rim else {})}
