"""``report.html`` and ``report.pdf`` of an estimate, from one template, with the fabric's passport:
a line with identity and key figures, and a QR code of the page's address, or of the line where
there is none."""

import io
from collections.abc import Sequence
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path

import numpy as np
import segno

from common.errors import shortened
from common.files import replace_file
from drapenet.report.figures import capture_and_curves, draw_spread, side_by_side
from drapenet.report.pages import in_words, render
from drapenet.report.pdf import WIDTH, as_pdf
from drapenet.result.document import CaptureAbout, EstimateDocument
from drapenet.result.files import (
    PAGE,
    PDF,
    REPORT,
    capture_names,
    fabric_name,
    pictures_of_strips,
    shown_texts,
)

_MAX_NAME = 40  # characters of a fabric's name in the code
_PIXELS, _BORDER = 6, 2  # of a module of the code, and modules around it
MAX_NAME_WIDTH = 28  # characters of a name in a table or picture


@dataclass(frozen=True)
class Passport:
    """Line of a fabric, and the address of its page, if any."""

    line: str
    address: str = ""

    @classmethod
    def of(cls, name: str, document: EstimateDocument, address: str = "") -> "Passport":
        """Of an estimate."""
        moduli = document.moduli.values()
        alpha, beta = (" ".join(quantity.texts()[0] for quantity in found) for found in (
            [each.alpha_uN_m for each in moduli], [each.beta_nN_m2 for each in moduli]))
        about = document.capture
        named = name.endswith(f" {about.density_g_m2:g} g/m²")  # a fabric without a name, by it
        parts = [f"DrapeNet {document.identity}", shortened(name, _MAX_NAME),
                 *[f"{about.density_g_m2:g} g/m2"] * (not named),
                 f"{' '.join(document.names)}: alpha {alpha} uN m, beta {beta} nN m2"]
        if about.drape_coefficient_percent is not None:
            parts.append(f"drape coefficient {about.drape_coefficient_percent:g} %")
        parts += [about.labels.conditions] * bool(about.labels.conditions)
        return cls("; ".join(parts), address)

    @property
    def code(self) -> bytes:
        """The QR code as PNG."""
        stream = io.BytesIO()
        segno.make(self.address or self.line, error="m", micro=False).save(
            stream, kind="png", scale=_PIXELS, border=_BORDER)
        return stream.getvalue()


@dataclass(frozen=True)
class ShownCapture:
    """A capture in a report; its picture, PNG, is empty if there is none, or ``large``: as wide as
    the page. It is left out of the estimate if it is a copy of the capture ``copy_of``."""

    name: str
    document: EstimateDocument
    picture: bytes
    large: bool = True
    copy_of: str = ""


def report_fabric(
    out: Path, document: EstimateDocument, captures: Sequence[tuple[EstimateDocument, Path]],
    strips: Sequence[Path], address: str,
) -> None:
    """Write the report of an estimate with the pictures that lie in the folders of its captures,
    each with its document, and of its strips; ``address`` as for :func:`write_report`."""
    files = [folder / REPORT for _, folder in captures]
    shown = [ShownCapture(name, part, file.read_bytes() if file.exists() else b"")
             for name, (part, _), file in zip(capture_names(document), captures, files,
                                              strict=True)]
    write_report(out, fabric_name(document), document, shown, strips=pictures_of_strips(strips),
                 address=address)


def in_all(captures: Sequence[ShownCapture]) -> list[str]:
    """Number of captures, their mean drape coefficient and its spread, in words, as ISO 9073-9 asks
    for them; of each tester if there are several. Copies do not count."""
    testers: dict[str, list[CaptureAbout]] = {}
    for about in (each.document.capture for each in captures if not each.copy_of):
        if about.drape_coefficient_percent is not None:
            testers.setdefault(about.rig, []).append(about)
    return [f"{_mean_coefficient(group)}{f', {in_words(rig)}' * (len(testers) > 1)}"
            for rig, group in testers.items() if len(group) > 1 or len(testers) > 1]


def _mean_coefficient(captures: Sequence[CaptureAbout]) -> str:
    """Mean drape coefficient of captures on one tester and its spread, also by face, in words."""
    faces: dict[str, list[float]] = {}
    for about in captures:
        face = "the marked face" if about.face == "up" else "the reverse"
        if (coefficient := about.drape_coefficient_percent) is not None:
            faces.setdefault(face, []).append(coefficient)
    every = [value for values in faces.values() for value in values]
    by_face = "; ".join(f"{np.mean(values):.1f} % with {face} on top ({len(values)})"
                        for face, values in faces.items())
    if len(every) == 1:
        return f"drape coefficient {every[0]:.1f} % of 1 capture"
    return (f"mean drape coefficient {np.mean(every):.1f} %, standard deviation "
            f"{np.std(every, ddof=1):.1f} points over {len(every)} captures"
            + (f": {by_face}" if len(faces) > 1 else ""))


def write_report(
    out: Path, title: str, document: EstimateDocument, captures: Sequence[ShownCapture], *,
    page: str = PAGE, scatter: np.ndarray | None = None, failed: int = 0,
    back: str = "", strips: Sequence[bytes] = (), address: str = "",
) -> None:
    """Write the report of an estimate and its ``captures`` as a page, and as PDF.

    ``scatter`` (3,) are factors by which alpha of the captures varies, ``failed`` is the number of
    captures without an estimate, ``back`` the address of the page of all fabrics, ``strips`` are
    pictures of strips, PNG, and ``address`` is that of the service's page of this fabric, for the
    code.
    """
    alone = [each.document.alphas_at(document.density) for each in captures]
    parts = [k for k, each in enumerate(captures) if not each.copy_of]
    spread = b"" if len(parts) < 2 else draw_spread(
        document, [shortened(captures[k].name, MAX_NAME_WIDTH) for k in parts],
        [alone[k] for k in parts])
    if len(captures) == 1 and captures[0].large and captures[0].picture:  # curves on the first page
        upper, curves = capture_and_curves(captures[0].picture)
        captures = [replace(captures[0], picture=upper)]
    else:
        curves = b""
    values = {
        "title": title,
        "document": document,
        "captures": captures,
        "alone": alone,
        "spread": spread,
        "curves": curves,
        "scatter": scatter,
        "failed": failed,
        "back": back,
        "strip_pictures": strips,
        "width": WIDTH,
        "known": document.known_values,
        "in_all": in_all(captures),
        "version": version("drapenet"),
        "texts": shown_texts,
        "passport": (passport := Passport.of(title, document, address))}
    replace_file(out / page, render("report.html", layout="base.html", **values))
    body, shorter = render("report.html", layout="print.html", **values).decode(), ""
    if curves:
        values |= {"curves": side_by_side(captures[0].picture, curves),
                   "captures": [replace(captures[0], picture=b"")]}
        shorter = render("report.html", layout="print.html", **values).decode()
    replace_file(out / PDF, as_pdf(body, title, passport.code, shorter))
