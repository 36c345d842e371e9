"""PDF of a page's body: headings, paragraphs, lists, tables and pictures in basic HTML."""

import io
import logging
from pathlib import Path

import matplotlib
from fpdf import FPDF
from fpdf.fonts import TextStyle
from fpdf.html import HTML2FPDF

SIDE = 24  # mm, of the code
WIDTH = 535  # points, of a picture as wide as the text
_SMALLER = 0.75  # of that, where it saves a page
_BESIDE_TABLES = 0.5  # mm, above and below
_FONT = "DejaVu"  # matplotlib's, with Greek and superscripts
_INK, _GREY = "#222222", "#666666"


def as_pdf(body: str, title: str, code: bytes, shorter: str = "") -> bytes:
    """A4 pages of a ``body`` in HTML, with a title at their foot and a QR ``code``, PNG, in the
    upper right corner of the first, where it takes no place; of a ``shorter`` body, and with
    smaller pictures and letters, where that saves a page."""
    # Each takes 0.3 s; a body that has a shorter is longer than a page.
    pages = _laid_out(shorter or body, title, code)
    if pages.page_no() > 1:
        large = _laid_out(body, title, code) if shorter else pages
        small = _laid_out(shorter or body, title, code, _SMALLER)
        pages = min(large, pages, small, key=_Pages.page_no)  # of as many pages the largest
    return bytes(pages.output())


def _laid_out(body: str, title: str, code: bytes, share: float = 1.0) -> "_Pages":
    letters = (1 + share) / 2
    for library in ("fpdf", "fontTools"):  # each step of fonts, and each letter that they lack
        logging.getLogger(library).setLevel(logging.ERROR)
    pages = _Pages(format="A4")
    pages.set_title(" ".join(title.split()))
    pages.set_margins(11, 12)
    pages.set_auto_page_break(True, margin=16)
    pages.set_image_filter("DCTDecode")  # ten times as fast as deflating again
    fonts = Path(matplotlib.get_data_path()) / "fonts" / "ttf"
    for style, file in (("", "DejaVuSans.ttf"), ("B", "DejaVuSans-Bold.ttf")):
        pages.add_font(_FONT, style, fonts / file)
    pages.set_font(_FONT, size=8.5 * letters)
    pages.set_draw_color(210)
    pages.add_page()
    pages.image(io.BytesIO(code), x=pages.w - pages.r_margin - SIDE, y=pages.t_margin, w=SIDE)
    body = body.replace(f'width="{WIDTH}"', f'width="{round(share * WIDTH)}"')
    pages.write_html(body, font_family=_FONT, li_prefix_color=_GREY, tag_styles={
        "p": TextStyle(font_size_pt=8.5 * letters, t_margin=1, b_margin=1.5),  # 0: a line
        **{name: TextStyle(color=_INK, font_style="B", font_size_pt=size * letters,
                           t_margin=above, b_margin=1)
           for name, size, above in (("h1", 16, 0), ("h2", 11, 2), ("h3", 9, 2))}})
    return pages


class _Html(HTML2FPDF):
    def _ln(self, h: float | None = None) -> None:
        super()._ln(_BESIDE_TABLES if h is None else h)  # without: a line of the largest heading


class _Pages(FPDF):
    HTML2FPDF_CLASS = _Html

    def footer(self) -> None:
        self.set_y(-12)
        self.set_font(_FONT, size=7)
        self.set_text_color(_GREY)
        self.cell(0, 5, f"{self.title}, page {self.page_no()} of {{nb}}", align="R")
