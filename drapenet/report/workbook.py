"""``results.xlsx``: numbers for a spreadsheet, with the decimal sign of the reader's locale."""

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import xlsxwriter
from xlsxwriter.worksheet import Worksheet

from common.findings import texts
from data.captures.description import UNLABELLED
from drapenet.result.document import COLUMNS, MAX_OUTSIDE_SHARE, EstimateDocument
from drapenet.result.tables import ENDS, at_ends

QUANTITIES = {"alpha_uN_m": ("α", "µN·m", "0.0"), "beta_nN_m2": ("β", "nN·m²", "0"),
              "drape_stiffness_uN_m": ("stiffness in a drape", "µN·m", "0.0"),
              "bending_length_mm": ("bending length", "mm", "0.0"),
              "flexural_rigidity_uN_m": ("flexural rigidity G", "µN·m", "0.0"),
              "kes_b_gf_cm2_per_cm": ("KES B", "gf·cm²/cm", "0.000"),
              "kes_2hb_gf_cm_per_cm": ("KES 2HB", "gf·cm/cm", "0.000")}
"""Name, unit and number format of quantities along a direction, by their key in the document."""
STRETCH = ("stretch, of bias: shear", "N/m", "0.0")
"""The same of what strips under weights measure."""
CONDITIONS = {"temperature_c": "temperature [°C]", "humidity_percent": "humidity [%]",
              "conditioning_h": "conditioning [h]"}
FAILED = ("fabric", "sample", "capture", "reason")
NOTES = (
    "Each line is a direction: warp, bias and weft, or stiff, bias and soft where the warp was "
    "not marked.",
    "face: up, the marked one on top, also where nothing was stated, or down; of captures of both, "
    "both; empty where nothing was draped.",
    "low68, high68: the true value lies between them with a probability of 68 %; low90, high90: "
    "90 %.",
    "All values are at the mass per area of the fabric; those of testers are computed from α and "
    "β. A fabric's drape coefficient and nodes are means over its captures, empty if these "
    "are of several testers.",
    f"KES B and 2HB are empty where more than {100 * MAX_OUTSIDE_SHARE:g} % of the samples of the "
    "estimate soften below 1.5 1/cm, so that the moduli do not determine them; 'KES not "
    "determined' is their share.",
    "poorly constrained: what was measured says little of this modulus, or of the ratio of the "
    "yarns, so that its value is mostly that of usual fabrics.",
    "A fabric without an estimate has one line, with its reason; the sheet failures lists all.")


@dataclass(frozen=True)
class Sample:
    """Rows of a sheet: ``names`` are its first cells, ``coefficient`` is in percent."""

    names: Mapping[str, str | int]
    document: EstimateDocument
    coefficient: float | None
    nodes: float | None


@dataclass(frozen=True)
class Unestimated:
    """The row of a fabric without an estimate: its first cells, and why."""

    names: Mapping[str, str | int]
    reason: str


def workbook(
    sheets: Mapping[str, Sequence[Sample | Unestimated]], failures: Sequence[Mapping[str, str]]
) -> bytes:
    """An xlsx file with a sheet of each name, three rows for each sample, and a sheet of the
    captures and fabrics that failed, with :data:`FAILED` of each."""
    stream = io.BytesIO()
    with xlsxwriter.Workbook(stream, {"in_memory": True}) as book:
        for name, samples in sheets.items():
            names = [*(samples[0].names if samples else ())]
            further = _further(samples)
            _fill(book, book.add_worksheet(name), _columns(names, further),
                  [row for sample in samples for row in _rows(sample, further)])
        _fill(book, book.add_worksheet("failures"), dict.fromkeys(FAILED, "@"),
              [[row[name] for name in FAILED] for row in failures])
        notes = book.add_worksheet("notes")
        for row, line in enumerate(NOTES):
            notes.write_string(row, 0, line)
    return stream.getvalue()


def _further(samples: Sequence[Sample | Unestimated]) -> list[str]:
    """Names of what was measured beside captures, but stretch and shear, which have a column."""
    documents = [sample.document for sample in samples if isinstance(sample, Sample)]
    return [*dict.fromkeys(name for document in documents for record in document.records
                           for name in record.columns() if name not in COLUMNS)]


def _columns(names: Sequence[str], further: Sequence[str]) -> dict[str, str]:
    """Number formats by column of a sheet whose first cells are ``names``."""
    names = [*names, "mass per area [g/m²]", "tester", "face", "direction"]
    return {**dict.fromkeys(names, "0"),
            **{f"{name}{end or ' median'} [{unit}]": text
               for name, unit, text in (*QUANTITIES.values(), STRETCH) for end in ENDS},
            **{f"{name}{end or ' median'}": "0.0" for name in further for end in ENDS},
            "poorly constrained": "@", "KES not determined [%]": "0.0",
            "drape coefficient [%]": "0.0", "nodes": "0.0",
            **dict.fromkeys(UNLABELLED.columns, "@"),
            "advice": "@", "warnings": "0", "warnings in words": "@"}


def _fill(
    book: xlsxwriter.Workbook, sheet: Worksheet, columns: Mapping[str, str],
    rows: Sequence[Sequence[str | float | None]],
) -> None:
    """Write a sheet of ``columns`` with their number formats."""
    head = book.add_format({"bold": True, "text_wrap": True, "valign": "top", "bottom": 1})
    for column, (name, text) in enumerate(columns.items()):
        sheet.write_string(0, column, CONDITIONS.get(name, name.replace("_", " ")), head)
        sheet.set_column(column, column, 11 if column else 24,
                         book.add_format({"num_format": text}))
    for row, values in enumerate(rows, start=1):
        for column, value in enumerate(values):
            if isinstance(value, str):  # never a formula
                sheet.write_string(row, column, value)
            elif value is not None:
                sheet.write_number(row, column, value)
    sheet.set_row(0, 48)
    sheet.freeze_panes(1, 1)
    sheet.autofilter(0, 0, len(rows), len(columns) - 1)


def _rows(sample: Sample | Unestimated, further: Sequence[str]) -> list[list[str | float | None]]:
    """Cells of the three directions, or of a fabric without an estimate."""
    if isinstance(sample, Unestimated):
        columns = _columns([*sample.names], further)
        return [[*sample.names.values(), *[None] * (len(columns) - len(sample.names) - 1),
                 f"no estimate: {sample.reason}"]]
    document, about, rows = sample.document, sample.document.capture, []
    shown = [part.capture for part in document.captures or []] or [about] * bool(about.source)
    face = " and ".join(sorted({each.face for each in shown}, reverse=True))
    for name, readings in document.laboratory.items():
        quantities = dict([*document.moduli[name], *readings])
        stretch = next(filter(None, (record.along(name) for record in document.records)), None)
        measured = {key: value for record in document.records
                    for key, value in record.columns().items()}
        numbers = [number for value in (*(quantities[key] for key in QUANTITIES), stretch,
                                        *(measured.get(key) for key in further))
                   for number in at_ends(value)]
        poor = ", ".join(
            each.replace("beta/alpha", "β").replace("alpha", "α").removesuffix(f" {name}")
            for each in document.poorly_constrained if name in each)
        rows.append([*sample.names.values(), about.density_g_m2, about.rig, face, name, *numbers,
                     poor, 100 * readings.kes_b_outside_law_probability, sample.coefficient,
                     sample.nodes, *about.labels.columns.values(),
                     "; ".join(texts(document.advice or [])), len(document.warnings),
                     "; ".join(texts(document.warnings))])
    return rows
