"""Tables and pages of batch inference, from estimates of fabrics: ``results.xlsx``,
``summary.csv``, ``fabrics.csv``, ``captures.csv``, ``failures.csv``, a report of each fabric, and
``index.html``.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import chain
from pathlib import Path

import numpy as np

from common.errors import shortened
from common.files import replace_file
from common.findings import texts
from drapenet.fabric.entries import COLUMNS, Entry
from drapenet.report.pages import render
from drapenet.report.report import MAX_NAME_WIDTH, ShownCapture, write_report
from drapenet.report.workbook import Sample, Unestimated, workbook
from drapenet.result.copies import copies, left_out
from drapenet.result.document import EstimateDocument
from drapenet.result.files import REPORT, pictures_of_strips
from drapenet.result.tables import ROLES, csv_number, csv_table, row_of

FAILURE = ("fabric", "sample", "capture", "path", "reason")
INDEX, THUMBNAIL, RESULTS = "index.html", "view.png", "results.xlsx"


@dataclass(frozen=True)
class FabricEstimate:
    """Estimate of a fabric from all its captures but copies, which do not count.

    Attributes:
        captures: and strips and known values, each with the document of its estimate.
        document: of the joint estimate of several captures, or of the only one.
        scatter: (3,) geometric standard deviation of the captures' alpha; None for one capture.
        failed: number of captures without an estimate.
    """

    name: str
    place: Path
    captures: list[tuple[Entry, EstimateDocument]]
    document: EstimateDocument
    scatter: np.ndarray | None
    failed: int = 0

    @cached_property
    def copies(self) -> dict[int, int]:
        """As :func:`drapenet.result.copies.copies` of the captures."""
        return copies([document for _, document in self.captures])

    @property
    def parts(self) -> list[EstimateDocument]:
        """Documents of the captures that take part."""
        return [document for k, (_, document) in enumerate(self.captures) if k not in self.copies]

    @property
    def shown(self) -> list[tuple[Entry, EstimateDocument]]:
        """The captures, with a warning of those that are copies."""
        faults = left_out([document for _, document in self.captures])
        return [(entry, document.warned(faults[k]) if k in faults else document)
                for k, (entry, document) in enumerate(self.captures)]

    @property
    def counts(self) -> dict[str, int]:
        """Numbers of captures that take part, and that failed."""
        return {"captures": len(self.parts), "captures_failed": self.failed}

    @property
    def means(self) -> dict[str, float | None]:
        """Drape coefficient and nodes, means over the captures that have them; None if they are of
        several testers."""
        one = len({document.capture.rig for document in self.parts} - {""}) == 1
        seen = {name: [value for document in self.parts
                       if one and (value := getattr(document.capture, name)) is not None]
                for name in ("drape_coefficient_percent", "nodes")}
        return {name: round(float(np.mean(values)), 2) if values else None
                for name, values in seen.items()}

    @property
    def means_text(self) -> dict[str, str]:
        """The means for a CSV table."""
        return {name: "" if value is None else csv_number(value)
                for name, value in self.means.items()}


@dataclass(frozen=True)
class Joined:
    """Estimates of fabrics, captures of fabrics that are not joined, and rows of what failed, by
    :data:`FAILURE`."""

    fabrics: list[FabricEstimate]
    apart: list[tuple[Entry, EstimateDocument]]
    failures: list[dict[str, str]]

    @property
    def captures(self) -> list[tuple[Entry, EstimateDocument]]:
        """All captures that have an estimate."""
        return [*chain.from_iterable(fabric.shown for fabric in self.fabrics), *self.apart]

    @property
    def unestimated(self) -> list[Unestimated]:
        """The fabrics without an estimate, with the reason that they are not joined, or why their
        captures failed."""
        found = []
        for name in dict.fromkeys(row["fabric"] for row in self.failures):
            rows = [row for row in self.failures if row["fabric"] == name]
            if any(fabric.name == name for fabric in self.fabrics):
                continue
            reasons = [row["reason"] for row in rows if not row["capture"]] or [
                f"{row['capture']}: {row['reason']}" for row in rows]
            found.append(Unestimated({
                "fabric": name, "captures": sum(entry.fabric == name for entry, _ in self.apart),
                "captures_failed": sum(bool(row["capture"]) for row in rows)}, "; ".join(reasons)))
        return found


def write_overview(out: Path, joined: Joined) -> None:
    """Write all tables and pages."""
    fabrics, failures = joined.fabrics, joined.failures
    for name, rows, columns in (
            ("summary", [_summary_row(fabric) for fabric in fabrics], ()),
            ("fabrics", [_fabric_row(fabric) for fabric in fabrics], ()),
            ("captures", [_capture_row(*capture) for capture in joined.captures], ()),
            ("failures", failures, FAILURE)):
        # Excel needs the byte order mark to detect UTF-8.
        replace_file(out / f"{name}.csv", csv_table(rows, columns).encode("utf-8-sig"))
    replace_file(out / RESULTS, fabrics_workbook(joined))
    for fabric in fabrics:
        _write_page(fabric, out)
    replace_file(out / INDEX, render("index.html", fabrics=fabrics, failures=failures, page=INDEX,
                                     thumbnail=THUMBNAIL))


def fabrics_workbook(joined: Joined) -> bytes:
    """``results.xlsx``: sheets of the fabrics, their captures, and what failed."""
    return workbook({
        "fabrics": [*(Sample({"fabric": fabric.name, **fabric.counts},
                             fabric.document, *fabric.means.values())
                      for fabric in joined.fabrics), *joined.unestimated],
        "captures": [Sample({name: getattr(entry, name) for name in COLUMNS}, document,
                            document.capture.drape_coefficient_percent, document.capture.nodes)
                     for entry, document in joined.captures]}, joined.failures)


def _write_page(fabric: FabricEstimate, out: Path) -> None:
    """Write the page of a fabric, and its report."""
    folder, document = out / fabric.place, fabric.document
    names = [f"{entry.sample}/{entry.capture}".strip("/") for entry, _ in fabric.captures]
    shown = [_shown(out, *capture, name, names[fabric.copies[k]] if k in fabric.copies else "")
             for k, (capture, name) in enumerate(zip(fabric.shown, names, strict=True))]
    write_report(folder, document.capture.labels.fabric or fabric.name, document, shown,
                 page=INDEX, scatter=fabric.scatter, failed=fabric.failed, back="../index.html",
                 strips=pictures_of_strips(out / entry.place for entry, _ in fabric.captures))


def _shown(
    out: Path, entry: Entry, document: EstimateDocument, name: str, copy_of: str
) -> ShownCapture:
    """A capture with the picture of its report, or its thumbnail."""
    large = (out / entry.place / REPORT).exists()
    file = out / entry.place / (REPORT if large else THUMBNAIL)
    return ShownCapture(name, document, file.read_bytes() if file.exists() else b"", large, copy_of)


def fabrics_text(fabrics: Sequence[FabricEstimate]) -> str:
    """A line for each fabric: name, number of captures, alpha, number of warnings; and its advice.
    """
    names = [shortened(fabric.name, MAX_NAME_WIDTH) for fabric in fabrics]
    width = max(len("fabric"), *map(len, names))
    lines = [f"{'fabric':{width}}{'captures':>10}"
             + "".join(f"{f'alpha {role}':>24}" for role in ("warp/stiff", "bias", "weft/soft"))
             + f"{'warnings':>10}   [µN·m, 68 %]"]
    for name, fabric in zip(names, fabrics, strict=True):
        figures = "".join(f"{moduli.alpha_uN_m!s:>24}"
                          for moduli in fabric.document.moduli.values())
        lines.append(f"{name:{width}}{fabric.counts['captures']:>10}{figures}"
                     f"{len(fabric.document.warnings) or '-':>10}")
    lines += [f"advice, {name}: {line}" for name, fabric in zip(names, fabrics, strict=True)
              for line in texts(fabric.document.advice or [])]
    return "\n".join(lines)


def _summary_row(fabric: FabricEstimate) -> dict[str, object]:
    """Row of the short table: alpha with its 68 % interval as text."""
    row: dict[str, object] = {"fabric": fabric.name, **fabric.counts, "density_g_m2": csv_number(
        fabric.document.capture.density_g_m2)}
    for role, moduli in zip(ROLES, fabric.document.moduli.values(), strict=True):
        row[f"{role}_alpha_uN_m"], row[f"{role}_68"] = moduli.alpha_uN_m.texts()
    return row | fabric.means_text | {"warnings": len(fabric.document.warnings)}


def _fabric_row(fabric: FabricEstimate) -> dict[str, object]:
    document = fabric.document
    return {
        "fabric": fabric.name,
        "samples": len({entry.sample for entry, _ in fabric.captures}),
        **fabric.counts,
        "captures_with_warnings": sum(bool(capture.warnings) for _, capture in fabric.shown),
        "rig": document.capture.rig, "directions": document.convention, **row_of(document),
        **fabric.means_text,
        **{f"alpha_{role}_scatter_factor":
           "" if fabric.scatter is None else csv_number(fabric.scatter[k])
           for k, role in enumerate(ROLES)},
        "poorly_constrained": "; ".join(document.poorly_constrained),
        **document.capture.labels.columns, **_sentences(document),
    }


def _capture_row(entry: Entry, document: EstimateDocument) -> dict[str, object]:
    return {"fabric": entry.fabric, "sample": entry.sample, "capture": entry.capture,
            "directions": document.convention, **row_of(document),
            "drape_coefficient_percent": document.capture.drape_coefficient_percent,
            "nodes": document.capture.nodes, **document.capture.labels.columns,
            **_sentences(document)}


def _sentences(document: EstimateDocument) -> dict[str, object]:
    return {"advice": "; ".join(texts(document.advice or [])),
            "flags": "; ".join(texts(document.warnings))}
