"""Outlines of drapes in text files: two columns, x and y, or angle in degrees and radius."""

import csv
import re
from pathlib import Path

import numpy as np

from common.documents import MAX_TABLE_BYTES, number, read_text, shown
from common.errors import InputError
from common.types import Outline

UNITS = {"mm": 1e-3, "m": 1.0}
MIN_POINTS = 36
MIN_TURN = 270.0  # degrees, that angles span at least
_PAIRS = ("x", "y"), ("angle", "radius")
_HEADING = re.compile(r"#?\s*(x|y|angle|radius)(?![a-z])[ _(\[]*(?:(mm|m)\b)?.*")
_LETTERS = re.compile("[a-df-z]")  # e is part of numbers


def read_closed_curve(file: Path, unit: str | None) -> Outline:
    """Read the curve of a text file; ``unit`` of :data:`UNITS`, if the header has none."""
    lines = [line.strip().lower() for line in
             read_text(file, MAX_TABLE_BYTES, "outline").splitlines() if line.strip()]
    names, stated = _header(lines.pop(0)) if lines and _LETTERS.search(lines[0]) else ([], None)
    pair = _pair(names) if names else None
    if stated and unit and stated != unit:
        raise InputError(f"its header states {stated}, capture.yaml states unit: {unit}; correct "
                         "one of them")
    unit = stated or unit
    if not unit:
        raise InputError("the unit of its lengths is not stated; give outline: {unit: mm}, or m")
    if len(lines) < MIN_POINTS:
        raise InputError(f"{len(lines)} points; an outline has at least {MIN_POINTS}")
    numbers = np.array([_numbers(line, len(names) or 2) for line in lines])
    # A curve around the origin has y of both signs, radii are positive.
    pair = pair or _PAIRS[int(numbers[:, 1].min() > 0)]
    first, second = numbers[:, [(names or pair).index(name) for name in pair]].T
    if pair == _PAIRS[1]:
        if (turn := np.ptp(first)) < MIN_TURN:
            raise InputError(f"its angles span {turn:.4g}°, at least {MIN_TURN:g}° are needed; "
                             "give degrees, or x and y about the plate's centre")
        angle = np.radians(first)
        first, second = second * np.cos(angle), second * np.sin(angle)
    return np.column_stack([first, second]) * UNITS[unit]


def _header(line: str) -> tuple[list[str], str | None]:
    """Names of the columns, and the unit of lengths if it is in them."""
    cells = re.split("[;,\t]", line) if re.search("[;,\t]", line) else line.split()
    headings = [_HEADING.fullmatch(cell.strip()) for cell in cells]
    units = {heading[2] for heading in headings if heading and heading[2]}
    if len(units) > 1:
        raise InputError(f"its header {shown(line)} has lengths in mm and m; give one unit")
    return [heading[1] if heading else "" for heading in headings], next(iter(units), None)


def _pair(names: list[str]) -> tuple[str, str]:
    for pair in _PAIRS:
        if set(pair) <= set(names):
            return pair
    raise InputError("its header has neither x and y nor angle and radius; name the columns, such "
                     "as x_mm;y_mm")


def _numbers(line: str, count: int) -> list[float]:
    """The numbers of a row; commas are decimal unless they separate the cells."""
    if re.search("[;\t]", line):
        cells = re.split("[;\t]", line)
    elif '"' in line:
        cells = next(csv.reader([line]))
    else:
        cells = re.split(r",?\s+", line) if " " in line else line.split(",")
    try:
        numbers = [number(cell) for cell in cells]
        if len(numbers) == count and np.isfinite(numbers).all():
            return numbers
    except ValueError:
        pass
    raise InputError(f"its row {shown(line)} does not have {count} numbers; separate numbers with "
                     "a decimal comma by semicolons")
