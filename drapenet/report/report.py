"""``report.html`` and ``report.pdf`` of an estimate, from one template."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from common.files import replace_file
from drapenet.report.pages import render
from drapenet.report.pdf import WIDTH, as_pdf
from drapenet.result.document import EstimateDocument
from drapenet.result.files import PAGE, PDF


@dataclass(frozen=True)
class ShownCapture:
    """A capture in a report; its picture, PNG, is empty if there is none, or ``large``: as wide as
    the page."""

    name: str
    document: EstimateDocument
    picture: bytes
    large: bool = True


def in_all(captures: Sequence[ShownCapture]) -> str:
    """Number of captures, their mean drape coefficient and its spread, in words, as ISO 9073-9 asks
    for them; empty if fewer than two have a drape coefficient."""
    seen: dict[str, list[float]] = {}
    for each in captures:
        about = each.document.capture
        if about.drape_coefficient_percent is not None:
            face = "the marked face" if about.face == "up" else "the reverse"
            seen.setdefault(face, []).append(about.drape_coefficient_percent)
    every = [value for values in seen.values() for value in values]
    if len(every) < 2:
        return ""
    faces = "; ".join(f"{np.mean(values):.1f} % with {face} on top ({len(values)})"
                      for face, values in seen.items())
    return (f"mean drape coefficient {np.mean(every):.1f} %, standard deviation "
            f"{np.std(every, ddof=1):.1f} points over {len(every)} captures"
            + (f": {faces}" if len(seen) > 1 else ""))


def write_report(
    out: Path, title: str, document: EstimateDocument, captures: Sequence[ShownCapture], *,
    page: str = PAGE, pdf: bool = True, spread: bytes = b"", scatter: np.ndarray | None = None,
    back: str = "",
) -> None:
    """Write the report of an estimate and its ``captures`` as a page, and as PDF.

    ``spread`` is a PNG of the captures' moduli, ``scatter`` (3,) are factors by which alpha varies,
    and ``back`` is the address of the page of all fabrics.
    """
    values = {"title": title, "document": document, "captures": captures, "spread": spread,
              "scatter": scatter, "back": back, "width": WIDTH, "known": document.known_values,
              "in_all": in_all(captures)}
    replace_file(out / page, render("report.html", layout="base.html", **values))
    if pdf:
        body = render("report.html", layout="print.html", **values).decode()
        replace_file(out / PDF, as_pdf(body, title))
