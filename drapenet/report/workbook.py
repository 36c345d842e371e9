"""``results.xlsx``: numbers for a spreadsheet, with the decimal sign of the reader's locale."""

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import xlsxwriter
from xlsxwriter.worksheet import Worksheet

from common.findings import texts
from data.captures.description import UNLABELLED
from drapenet.result.document import MAX_COMPARED_SHARE, EstimateDocument, Quantity

QUANTITIES = {"alpha_uN_m": ("α", "µN·m", "0.0"), "beta_nN_m2": ("β", "nN·m²", "0"),
              "drape_stiffness_uN_m": ("stiffness in a drape", "µN·m", "0.0"),
              "bending_length_mm": ("bending length", "mm", "0.0"),
              "flexural_rigidity_uN_m": ("flexural rigidity G", "µN·m", "0.0"),
              "kes_b_gf_cm2_per_cm": ("KES B", "gf·cm²/cm", "0.000"),
              "kes_2hb_gf_cm_per_cm": ("KES 2HB", "gf·cm/cm", "0.000")}
"""Name, unit and number format of quantities along a direction, by their key in the document."""
NOTES = (
    "Each line is a direction: warp, bias and weft, or stiff, bias and soft where the direction of "
    "the warp was not stated.",
    "low and high: the true value lies between them with a probability of 68 %.",
    "All values are at the mass per area of the fabric; those of testers are computed from α and "
    "β. A fabric's drape coefficient and nodes are means over its captures, empty if these "
    "are of several testers.",
    "KES B and 2HB are empty where most of the samples of the estimate soften below 1.5 1/cm, so "
    "that the moduli do not determine them; 'KES not determined' is their share. Do not compare "
    f"them with measured values where it exceeds {100 * MAX_COMPARED_SHARE:g} %.")


@dataclass(frozen=True)
class Sample:
    """Rows of a sheet: ``names`` are its first cells, ``coefficient`` is in percent."""

    names: Mapping[str, str | int]
    document: EstimateDocument
    coefficient: float | None
    nodes: float | None


def workbook(sheets: Mapping[str, Sequence[Sample]]) -> bytes:
    """An xlsx file with a sheet of each name, three rows for each sample."""
    stream = io.BytesIO()
    with xlsxwriter.Workbook(stream, {"in_memory": True}) as book:
        for name, samples in sheets.items():
            _fill(book, book.add_worksheet(name), samples)
        notes = book.add_worksheet("notes")
        for row, line in enumerate(NOTES):
            notes.write_string(row, 0, line)
    return stream.getvalue()


def _fill(book: xlsxwriter.Workbook, sheet: Worksheet, samples: Sequence[Sample]) -> None:
    head = book.add_format({"bold": True, "text_wrap": True, "valign": "top", "bottom": 1})
    names = [*(samples[0].names if samples else ()), "mass per area [g/m²]", "tester", "face",
             "direction"]
    columns = {**dict.fromkeys(names, "0"),
               **{f"{name} {end} [{unit}]": text for name, unit, text in QUANTITIES.values()
                  for end in ("median", "low", "high")},
               "KES not determined [%]": "0.0", "drape coefficient [%]": "0.0", "nodes": "0.0",
               **dict.fromkeys(UNLABELLED.columns, "@"),
               "warnings": "0", "warnings in words": "@"}
    for column, (name, text) in enumerate(columns.items()):
        sheet.write_string(0, column, name.replace("_", " "), head)
        sheet.set_column(column, column, 11 if column else 24,
                         book.add_format({"num_format": text}))
    rows = [row for sample in samples for row in _rows(sample)]
    for row, values in enumerate(rows, start=1):
        for column, value in enumerate(values):
            if isinstance(value, str):  # never a formula
                sheet.write_string(row, column, value)
            elif value is not None:
                sheet.write_number(row, column, value)
    sheet.set_row(0, 48)
    sheet.freeze_panes(1, 1)
    sheet.autofilter(0, 0, len(rows), len(columns) - 1)


def _rows(sample: Sample) -> list[list[str | float | None]]:
    """Cells of the three directions."""
    document, about, rows = sample.document, sample.document.capture, []
    face = "" if about.sources else about.face
    for name, readings in document.laboratory.items():
        quantities = dict([*document.moduli[name], *readings])
        numbers = [number for key in QUANTITIES for number in _ends(quantities[key])]
        rows.append([*sample.names.values(), about.density_g_m2, about.rig, face, name, *numbers,
                     100 * readings.kes_b_outside_law_probability, sample.coefficient,
                     sample.nodes, *about.labels.columns.values(), len(document.warnings),
                     "; ".join(texts(document.warnings))])
    return rows


def _ends(quantity: Quantity | None) -> list[float | None]:
    """Median and 68 % interval."""
    return [None] * 3 if quantity is None else [quantity.median, *quantity.interval_68]
