"""Tables and pages of batch inference: ``summary.csv``, ``fabrics.csv``, ``captures.csv``,
``failures.csv``, a page for each fabric, and ``index.html``.

They are made from the files of finished captures (:mod:`drapenet.batch.batch`); estimates of one
fabric are joined (:mod:`drapenet.result.joint`).
"""

import io
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from common.errors import InputError
from common.files import remove_file, replace_file, replace_json
from data.captures.capture import require_one_fabric
from drapenet.batch.captures import Entry
from drapenet.report.figures import COLOURS
from drapenet.report.pages import render
from drapenet.result.content import Result
from drapenet.result.joint import joint_result
from drapenet.result.output import ESTIMATE, REPORT, THUMBNAIL, read_result
from drapenet.result.table import csv_number, csv_table, interval_columns, with_interval
from sim.material import DIRECTIONS, LINEAR

ROLES = ("warp_or_stiff", "bias", "weft_or_soft")
"""Directions in tables whose fabrics need not all have a marked warp."""
FAILURE = ("fabric", "sample", "capture", "path", "reason")
SPREAD, INDEX = "captures.png", "index.html"


@dataclass(frozen=True)
class FabricResult:
    """Result of a fabric from all its captures.

    Attributes:
        content: of ``estimate.json``; the joint estimate of several captures.
        scatter: (3,) geometric standard deviation of the captures' alpha by direction; NaN for a
            single capture.
    """

    name: str
    place: Path
    captures: list[tuple[Entry, Result]]
    content: dict[str, Any]
    scatter: np.ndarray

    @property
    def doubted(self) -> int:
        """Number of captures with warnings."""
        return sum(bool(one.content["warnings"]) for _, one in self.captures)

    @property
    def warnings(self) -> int:
        """Number of warnings of all captures and of the joint estimate."""
        own = sum(len(one.content["warnings"]) for _, one in self.captures)
        together = len(self.content["warnings"]) - self.doubted if len(self.captures) > 1 else 0
        return own + together


def write_overview(
    out: Path, outcomes: Sequence[tuple[Entry, str]]
) -> tuple[list[FabricResult], int]:
    """Write all tables and pages; return the results of fabrics, and the number of fabrics whose
    captures cannot be joined.

    Args:
        outcomes: all captures, each with the reason for a failure, or ''.
    """
    failures = [dict(zip(FAILURE, (entry.fabric, entry.sample, entry.capture, str(entry.path),
                                   failure.removeprefix(f"{entry.path}: ")), strict=True))
                for entry, failure in outcomes if failure]
    fabrics, apart = [], 0
    ordered = sorted((entry for entry, failure in outcomes if not failure),
                     key=lambda entry: (entry.fabric, entry.place))
    for name, entries in groupby(ordered, key=lambda entry: entry.fabric):
        try:
            fabrics.append(_fabric(name, list(entries), out))
        except InputError as error:
            apart += 1
            failures.append(dict.fromkeys(FAILURE, "") | {"fabric": name, "reason": str(error)})
    for name, rows, columns in (
            ("summary", [_summary_row(one) for one in fabrics], ()),
            ("fabrics", [_fabric_row(one) for one in fabrics], ()),
            ("captures", [_capture_row(*one) for each in fabrics for one in each.captures], ()),
            ("failures", failures, FAILURE)):
        # Excel needs the byte order mark to detect UTF-8.
        replace_file(out / f"{name}.csv", csv_table(rows, columns).encode("utf-8-sig"))
    for fabric in fabrics:
        folder = out / fabric.place
        replace_json(folder / ESTIMATE, fabric.content)
        replace_file(folder / SPREAD, _spread(fabric))
        replace_file(folder / INDEX, render(
            "fabric.html", fabric=fabric, estimate=ESTIMATE, thumbnail=THUMBNAIL, report=REPORT,
            spread=SPREAD, reports={entry.place for entry, _ in fabric.captures
                                    if (out / entry.place / REPORT).exists()}))
    places = {Path(entry.place.parts[0]) for entry, _ in outcomes}
    for place in places - {one.place for one in fabrics}:  # remove results of an earlier run
        for name in (ESTIMATE, SPREAD, INDEX):
            remove_file(out / place / name)
    replace_file(out / INDEX, render("index.html", fabrics=fabrics, failures=failures, page=INDEX,
                                     thumbnail=THUMBNAIL))
    return fabrics, apart


def _fabric(name: str, entries: Sequence[Entry], out: Path) -> FabricResult:
    results = [read_result(out / entry.place) for entry in entries]
    require_one_fabric([one.content["capture"]["rig"] for one in results],
                       [one.estimate.names == DIRECTIONS for one in results],
                       [one.estimate.density for one in results],
                       [(about["source"], about["views_sha256"]) for about in
                        (one.content["capture"] for one in results)])
    joint, scatter = results[0], np.full(3, np.nan)
    if len(results) > 1:
        joint = joint_result(results)
        middles = [one.estimate.samples[:, LINEAR].mean(axis=0) for one in results]
        scatter = np.exp(np.std(middles, axis=0, ddof=1))
    return FabricResult(name, Path(entries[0].place.parts[0]),
                        list(zip(entries, results, strict=True)), joint.content, scatter)


def _summary_row(fabric: FabricResult) -> dict[str, object]:
    """Row of the short table: alpha with its 68 % interval as text."""
    row: dict[str, object] = {"fabric": fabric.name, "captures": len(fabric.captures),
                              "density_g_m2": csv_number(fabric.content["capture"]["density_g_m2"])}
    for role, moduli in zip(ROLES, fabric.content["moduli"].values(), strict=True):
        median, interval = with_interval(moduli["alpha_uN_m"])
        row |= {f"{role}_alpha_uN_m": median, f"{role}_68": interval}
    return row | {"drape_coefficient_percent": _coefficient(fabric), "warnings": fabric.warnings}


def _coefficient(fabric: FabricResult) -> str:
    values = [one.content["capture"]["drape_coefficient_percent"] for _, one in fabric.captures]
    known = [value for value in values if value is not None]
    return csv_number(np.mean(known)) if known else ""


def _fabric_row(fabric: FabricResult) -> dict[str, object]:
    several = len(fabric.captures) > 1
    return {
        "fabric": fabric.name,
        "samples": len({entry.sample for entry, _ in fabric.captures}),
        "captures": len(fabric.captures), "captures_with_warnings": fabric.doubted,
        "rig": fabric.content["capture"]["rig"], "directions": fabric.content["convention"],
        **_figures(fabric.content),
        "drape_coefficient_percent": _coefficient(fabric),
        **{f"alpha_{role}_scatter_factor": csv_number(factor) if several else ""
           for role, factor in zip(ROLES, fabric.scatter, strict=True)},
        "poorly_constrained": "; ".join(fabric.content["poorly_constrained"]),
        "flags": "; ".join(fabric.content["warnings"]),
    }


def _capture_row(entry: Entry, result: Result) -> dict[str, object]:
    content = result.content
    return {"fabric": entry.fabric, "sample": entry.sample, "capture": entry.capture,
            "directions": content["convention"], **_figures(content),
            "drape_coefficient_percent": content["capture"]["drape_coefficient_percent"],
            "flags": "; ".join(content["warnings"])}


def _figures(content: dict[str, Any]) -> dict[str, object]:
    """Columns of moduli, at the fabric's density and at 300 g/m², and of testers' readings."""
    row: dict[str, object] = {"density_g_m2": csv_number(content["capture"]["density_g_m2"])}
    tables = (("", content["moduli"]), ("_at_300_g_m2", content["moduli_at_300_g_m2"]),
              ("", content["laboratory"]))
    for suffix, table in tables:
        for role, quantities in zip(ROLES, table.values(), strict=True):
            for quantity, value in quantities.items():
                name = f"{role}_{quantity}{suffix}"
                if isinstance(value, float):
                    row[name] = csv_number(value)
                else:
                    row |= interval_columns(name, value)
    return row


def _spread(fabric: FabricResult) -> bytes:
    """PNG: alpha of every capture with its 68 % interval, and the fabric's as a band."""
    names = list(fabric.content["moduli"])
    figure = Figure(figsize=(9, 2.2 + 0.22 * len(fabric.captures)), layout="constrained")
    for k, (axes, name) in enumerate(zip(figure.subplots(1, 3, sharey=True), names, strict=True)):
        joint = fabric.content["moduli"][name]["alpha_uN_m"]
        axes.axvspan(*joint["interval_68"], color=COLOURS[k], alpha=0.2, lw=0)
        axes.axvline(joint["median"], color=COLOURS[k], lw=1)
        for row, (_, one) in enumerate(fabric.captures):
            each = one.content["moduli"][list(one.content["moduli"])[k]]["alpha_uN_m"]
            axes.plot(each["interval_68"], [row, row], color=COLOURS[k], lw=1.5)
            axes.plot(each["median"], row, "o", color=COLOURS[k], ms=4)
        axes.set(title=f"alpha {name} [µN·m]", ylim=(len(fabric.captures) - 0.4, -0.6))
        axes.set_yticks(range(len(fabric.captures)), [
            _short(entry) for entry, _ in fabric.captures], fontsize=8, parse_math=False)
    picture = io.BytesIO()
    figure.savefig(picture, format="png", dpi=100, metadata={"Software": None})
    return picture.getvalue()


def _short(entry: Entry) -> str:
    text = f"{entry.sample}/{entry.capture}".strip("/")
    return text if len(text) <= 28 else "…" + text[-27:]
