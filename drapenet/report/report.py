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
              "scatter": scatter, "back": back, "width": WIDTH, "known": document.known_values}
    replace_file(out / page, render("report.html", layout="base.html", **values))
    if pdf:
        body = render("report.html", layout="print.html", **values).decode()
        replace_file(out / PDF, as_pdf(body, title))
