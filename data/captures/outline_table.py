"""Outlines of drapes in text files: two columns, x and y, or angle in degrees and radius."""

import re
from contextlib import suppress
from pathlib import Path

import numpy as np

from common.errors import InputError, shown
from common.tables import Row, named_columns, number, read_rows
from common.types import Outline
from data.captures.description import OutlineSource

UNITS = {"mm": 1e-3, "m": 1.0, "cm": 1e-2, **dict.fromkeys(("in", "inch", "inches"), 0.0254),
         **dict.fromkeys(("um", "\u00b5m", "\u03bcm"), 1e-6)}  # micro sign and Greek letter
MIN_POINTS = 36
MIN_TURN = 270.0  # degrees, that angles span at least
MAX_TURN = 370.0  # cloth may swing back
MIN_RETURN = 0.25  # of the steps of x around a curve go back; fewer may be of disordered angles
CARTESIAN, POLAR = ("x", "y"), ("angle", "radius")
_UNIT = "|".join(name for name in UNITS if name != "in")
_HEADING = re.compile(rf"(x|y|angle|radius)(?![a-z])[ _(\[]*(?:in[ _])?"
                      rf"(?:({_UNIT}|in(?! *\w))\b)?.*")  # "x in mm" has no inches
_UNIT_ROW = re.compile(rf"[(\[]?({_UNIT}|in)[)\]]?")
_NOT_READ = re.compile(r"(?<![a-z])(px|pixels?|dm|ft|yd|gon|grads?|rad(ians?)?)(?![a-z])")


def read_closed_curve(file: Path, source: OutlineSource, *, handed: bool = True) -> Outline:
    """Read the curve of a text file, m; x to the right, y up in a picture from above.

    Args:
        source: what is stated of the file.
        handed: whether a mirrored curve would be that of another fabric, so that the sense of y and
            of angles is asked for where the numbers make it doubtful.
    """
    rows = read_rows(file, "outline")
    begin = next((k for k, (_, cells) in enumerate(rows) if _count(cells) > 1), len(rows))
    if rows and begin == len(rows):
        _numbers(rows[-1], [0, 1], 2)  # raises
    names, stated = _heads([cells for _, cells in rows[:begin]], rows[begin:])
    pair = _pair(names) if names else None
    unit = stated or source.unit
    if stated and source.unit and stated != source.unit:
        raise InputError(f"its header states {stated}, capture.yaml states unit: {source.unit}; "
                         "correct one of them")
    if not unit:
        raise InputError("the unit of its lengths is not stated; give outline: {unit: mm}, or m, "
                         "or name it in the header, such as x_cm;y_cm")
    if len(rows) - begin < MIN_POINTS:
        raise InputError(f"{len(rows) - begin} points; an outline has at least {MIN_POINTS}")
    places = [names.index(name) for name in pair] if pair else [0, 1]
    first, second = np.array([_numbers(row, places, len(names) or 2) for row in rows[begin:]]).T
    if (pair or _guessed(first, second)) == POLAR:
        curve = _from_angles(first, second, source, handed=handed)
    else:
        curve = _from_coordinates(first, second, source, handed=handed)
    return curve * UNITS[unit]


def _heads(heads: list[list[str]], rows: list[Row]) -> tuple[list[str], str | None]:
    """Names of the columns, '' for others, and the unit of lengths, from the lines before the
    numbers; no names if there are no lines.
    """
    names: list[str] = []
    units = set()
    for cells in heads:
        if cells[0] == "#":  # before a name, as numpy writes it
            cells = cells[1:]
        cells = named_columns([cell.lstrip("# ").lower() for cell in cells], rows)
        headings = [_HEADING.fullmatch(cell) for cell in cells]
        if not names and sum(map(bool, headings)) > 1:
            names = [heading[1] if heading else "" for heading in headings]
            units |= {heading[2] for heading in headings if heading and heading[2]}
        elif names:
            units |= {found[1] for cell in cells if (found := _UNIT_ROW.fullmatch(cell))}
        used = " ".join(cell for name, cell in zip(names, cells, strict=False) if name)
        if other := _NOT_READ.search(used):
            raise InputError(f"its header states {other[1]}; give lengths in mm (pixels divided by "
                             "those of a mm), angles in degrees, and name them, such as x_mm;y_mm")
    if heads and not names:
        names = [""]
    if len(units) > 1:
        raise InputError(f"its header has lengths in {' and '.join(sorted(units))}; give one unit")
    return names, next(iter(units), None)


def _pair(names: list[str]) -> tuple[str, str]:
    for pair in (CARTESIAN, POLAR):
        if set(pair) <= set(names):
            if twice := next((name for name in pair if names.count(name) > 1), None):
                raise InputError(f"its header has two columns {twice}; remove one")
            return pair
    raise InputError("its header has neither x and y nor angle and radius; name the columns, such "
                     "as x_mm;y_mm")


def _count(cells: list[str]) -> int:
    """How many cells are numbers."""
    found = 0
    for cell in cells:
        with suppress(ValueError):
            number(cell)
            found += 1
    return found


def _numbers(row: Row, places: list[int], count: int) -> list[float]:
    """The numbers in two of ``count`` cells."""
    line, cells = row
    with suppress(ValueError, IndexError):
        numbers = [number(cells[place]) for place in places]
        if np.isfinite(numbers).all() and len(cells) <= count:
            return numbers
    raise InputError(f"its line {line}, {shown(' '.join(cells))}, does not have {count} numbers; "
                     "write digits alone, without marks between thousands, separate numbers with a "
                     "decimal comma by semicolons, and name more than two columns")


def _guessed(first: np.ndarray, second: np.ndarray) -> tuple[str, str]:
    """What two columns without names are: x goes forth and back around a curve, angles do not."""
    if second.min() <= 0:  # radii are positive
        return CARTESIAN
    steps = np.diff(first, append=first[0])
    back = min((steps > 0).sum(), (steps < 0).sum())
    if back <= 1:  # where angles begin again
        return POLAR
    if back < MIN_RETURN * len(steps):
        raise InputError("its columns may be x and y, or angle and radius; name them in a first "
                         "line, such as x_mm;y_mm")
    return CARTESIAN


def _from_angles(
    degrees: np.ndarray, radius: np.ndarray, source: OutlineSource, *, handed: bool
) -> np.ndarray:
    """The curve (N, 2) in the unit of ``radius``."""
    if source.y_axis:
        raise InputError("outline.y_axis is of x and y, but the file has angle and radius; give "
                         "outline: {angles: counter-clockwise}, or clockwise")
    if (turn := np.ptp(degrees)) < MIN_TURN:
        raise InputError(f"its angles span {turn:.4g}°, at least {MIN_TURN:g}° are needed; "
                         "give degrees, or x and y about the plate's centre")
    if turn > MAX_TURN:
        raise InputError(f"its angles span {turn:.4g}°, more than a turn; give degrees, not gon")
    if handed and not source.angles and (np.diff(degrees) < 0).mean() > 0.5:
        raise InputError("its angles descend, as if they were counted clockwise; state outline: "
                         "{angles: clockwise}, or counter-clockwise, as seen from above")
    angle = np.radians(degrees) * (-1 if source.angles == "clockwise" else 1)
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])


def _from_coordinates(
    x: np.ndarray, y: np.ndarray, source: OutlineSource, *, handed: bool
) -> np.ndarray:
    """The curve (N, 2) in the unit of ``x`` and ``y``."""
    if source.angles:
        raise InputError("outline.angles is of angle and radius, but the file has x and y; give "
                         "outline: {y_axis: up}, or down")
    outside = any(column.min() > 0 or column.max() < 0 for column in (x, y))
    positive = bool(min(x.min(), y.min()) >= 0)
    missing = ["centred: false"] * (outside and "centred" not in source.model_fields_set)
    doubtful = handed and positive and not source.y_axis
    if doubtful:
        missing.append("y_axis: down")
    if missing:
        raise InputError(
            ("all its coordinates are positive, as in a picture, where y mostly points down" if
             doubtful else "the origin of its coordinates lies outside of the outline")
            + f"; state outline: {{{', '.join(missing)}}}" + ", or y_axis: up" * doubtful)
    return np.column_stack([x, -y if source.y_axis == "down" else y])
