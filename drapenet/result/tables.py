"""Estimates as rows of tables for spreadsheets."""

import csv
import io
from collections.abc import Mapping, Sequence

from drapenet.measured.base import Quantity
from drapenet.result.document import COLUMNS, EstimateDocument

ROLES = ("warp_or_stiff", "bias", "weft_or_soft")
"""Directions in tables whose fabrics need not all have a marked warp."""
ENDS = ("", "_low68", "_high68", "_low90", "_high90")
"""Of columns' names: of median and intervals."""
_FORMULA = tuple("=+-@\t\r\n")  # first characters of cells that spreadsheets evaluate


def row_of(document: EstimateDocument) -> dict[str, str]:
    """Columns of a CSV table: moduli, at the fabric's density and at 300 g/m², readings, and what
    was measured beside captures."""
    row = {"density_g_m2": csv_number(document.capture.density_g_m2)}
    for suffix, table in (("", document.moduli), ("_at_300_g_m2", document.moduli_at_300_g_m2),
                          ("", document.laboratory)):
        for role, quantities in zip(ROLES, table.values(), strict=True):
            for quantity, value in quantities:
                name = f"{role}_{quantity}{suffix}"
                row |= ({name: csv_number(value)} if isinstance(value, float)
                        else interval_columns(name, value))
    measured: dict[str, Quantity | None] = dict.fromkeys(COLUMNS)
    for record in document.records:
        measured |= record.columns()
    for name, quantity in measured.items():
        row |= interval_columns(name, quantity)
    return row


def interval_columns(name: str, quantity: Quantity | None) -> dict[str, str]:
    """Median and intervals as columns of a CSV table; empty for None."""
    return {f"{name}{end}": "" if value is None else csv_number(value)
            for end, value in zip(ENDS, at_ends(quantity), strict=True)}


def at_ends(quantity: Quantity | None) -> list[float | None]:
    """Median and intervals, as :data:`ENDS`."""
    return [None] * len(ENDS) if quantity is None else [
        quantity.median, *quantity.interval_68, *quantity.interval_90]


def csv_number(value: float) -> str:
    """A number for a CSV table."""
    return f"{value:.6g}"


def csv_table(rows: Sequence[Mapping[str, object]], columns: Sequence[str] = ()) -> str:
    """CSV table for spreadsheets; ``columns`` is needed if there may be no rows. Cells that a row
    has not are empty."""
    stream = io.StringIO()
    every = dict.fromkeys(name for row in ([dict.fromkeys(columns)] if columns else rows)
                          for name in row)
    writer = csv.DictWriter(stream, list(every), lineterminator="\n")
    writer.writeheader()
    writer.writerows({name: _cell(value) for name, value in row.items()} for row in rows)
    return stream.getvalue()


def _cell(value: object) -> object:
    """Escape text that a spreadsheet would evaluate as a formula; numbers are not changed."""
    if not isinstance(value, str) or not value.startswith(_FORMULA):
        return "" if value is None else value
    try:
        float(value)
    except ValueError:
        return "'" + value
    return value
