"""The testers that captures may be of: names and numbers, with their limits."""

from collections.abc import Mapping
from typing import Annotated, Literal

from pydantic import PlainValidator

from common.documents import Schema
from common.errors import InputError
from sim.rig import RIGS, Rig

SIZES, PLATES, MIN_OVERHANG = (200.0, 400.0), (60.0, 200.0), 20.0  # mm
TESTERS = tuple(name for name, rig in RIGS.items() if rig.has_plate)
"""Abbreviations of common testers."""
EXAMPLE = "{specimen: disc, size_mm: 254, plate_mm: 127}"
_CHOICES = f"{', '.join(TESTERS)}, or numbers such as {EXAMPLE}"
MISSING_TESTER = f"give tester: {_CHOICES}"
"""Remedy for a capture without tester."""


class _Numbers(Schema):
    specimen: Literal["square", "disc"]
    size_mm: float
    plate_mm: float


def read_tester(value: object) -> Rig:
    """The tester that a document states: the name of a rig, or a mapping as :data:`EXAMPLE`.

    The message of an InputError continues a sentence that begins with the value.
    """
    try:
        if isinstance(value, Mapping):
            numbers = _Numbers.of(value, "")
            rig = Rig(numbers.size_mm / 1e3, numbers.plate_mm / 1e3, numbers.specimen)
        else:
            rig = Rig.from_name(value if isinstance(value, str) else "")
    except InputError as error:
        reason = f" ({error})" if isinstance(value, Mapping) else ""
        raise InputError(f"is not a tester{reason}; give {_CHOICES}") from None
    size, plate = (round(1e3 * length, 6) for length in (rig.specimen_size, rig.plate_diameter))
    for what, length, (low, high) in (("specimen", size, SIZES), ("plate", plate, PLATES)):
        if not low <= length <= high:
            raise InputError(f"has a {what} of {length:g} mm; give {low:g} to {high:g} mm")
    if (overhang := (size - plate) / 2) < MIN_OVERHANG:
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


def described_tester(rig: Rig) -> str | dict[str, str | float]:
    """The value that :func:`read_tester` reads as ``rig``, in JSON types."""
    if rig.name in TESTERS:
        return rig.name
    return {"specimen": rig.specimen, "size_mm": round(1e3 * rig.specimen_size, 6),
            "plate_mm": round(1e3 * rig.plate_diameter, 6)}
