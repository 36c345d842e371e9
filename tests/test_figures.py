"""Figures in the documentation are those of the reports."""

import re
from pathlib import Path

import pytest

from common.errors import InputError
from data.captures.description import Description, Labels, OutlineSource
from drapenet.measured.strips.description import Scale, StripEntry, StripsDescription
from drapenet.measured.tension.description import StretchedStrip, TensionDescription
from drapenet.result.document import EstimateDocument
from experiments.figures.claims import slug
from experiments.figures.of_models import meaning
from experiments.figures.pages import BLOCKS, MARK, PAGES, fill_blocks
from experiments.report import ROOT
from experiments.study import FILES, study


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_pages_have_the_figures_of_the_reports(page):
    text = page.read_text(encoding="utf-8")
    assert text == fill_blocks(text), "run `make docs`"
    assert text.count("<!-- figures:") == text.count("<!-- end -->") == len(MARK.findall(text))


def test_every_block_has_a_place():
    named = {mark[1] for page in PAGES for mark in MARK.findall(page.read_text(encoding="utf-8"))}
    assert named == {*BLOCKS, *(name for name in FILES if study(name).block)}


def headings(page: Path) -> set[str]:
    """Anchors of a page."""
    return {slug(line.lstrip("# ")) for line in page.read_text(encoding="utf-8").splitlines()
            if line.startswith("#")}


def test_links_between_pages_lead_somewhere():
    for page in PAGES:
        for target in re.findall(r"\]\((?!https?:)([^)\s]+)\)", page.read_text(encoding="utf-8")):
            name, _, anchor = target.partition("#")
            file = (page.parent / name).resolve() if name else page
            assert file.exists(), f"{page.relative_to(ROOT)}: {target}"
            assert not anchor or anchor in headings(file), f"{page.relative_to(ROOT)}: {target}"


@pytest.mark.parametrize("model", [
    Description, OutlineSource, Labels, StripsDescription, StripEntry, Scale, TensionDescription,
    StretchedStrip, EstimateDocument])
def test_every_key_that_is_written_has_its_meaning(model):
    assert [name for name, field in model.model_fields.items() if not meaning(field)
            and not name.startswith("schema")] == []


def test_an_unknown_block_is_refused():
    with pytest.raises(InputError, match="figures: nothing is not a block"):
        fill_blocks("<!-- figures: nothing -->\n<!-- end -->\n")
