"""Blocks by name, and the pages that they are part of."""

import re
from collections.abc import Callable

from common.errors import InputError
from common.files import replace_file
from experiments.figures import claims, of_estimates, of_models
from experiments.figures.reports import Reports
from experiments.report import ROOT, Report
from experiments.study import FILES, study

PAGES = (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")))
MARK = re.compile(r"(<!-- figures: (\w+) -->\n).*?(<!-- end -->)", re.DOTALL)
BLOCKS: dict[str, Callable[[Reports], str]] = {
    block.__name__: block for block in (
        claims.claims, of_estimates.demo, of_estimates.fifteen_minutes, of_estimates.accuracy,
        of_estimates.views_and_drapes, of_estimates.photographed, of_estimates.cells,
        of_estimates.refinement, of_estimates.bands, of_models.capture_keys, of_models.strips_keys,
        of_models.tension_keys, of_models.known_keys, of_models.estimate_keys,
        of_models.shard_arrays)
}
"""Blocks of several reports; that of one study has its name, and is its ``block``."""


def text_of(name: str, reports: Reports) -> str:
    """The text of a block; InputError for an unknown one."""
    if name in BLOCKS:
        return BLOCKS[name](reports)
    if name in FILES and (block := study(name).block):
        return block(reports[name])
    raise InputError(f"figures: {name} is not a block; known: {', '.join(BLOCKS)}, and studies")


def shown(name: str, report: Report) -> str:
    """The claims and the block of a study, from a new report."""
    reports = Reports()
    try:
        reports.add(name, report)
        parts = [f"{claim.partition('](')[0].lstrip('[')}: {text} (target: {target})"
                 for claim, text, target, _ in claims.claim_rows(reports, name)]
        if name in FILES and study(name).block:
            parts.append(text_of(name, reports))
        return "\n".join(parts)
    except (KeyError, IndexError, TypeError, ValueError, ZeroDivisionError, StopIteration):
        return "The settings are too small for the claims of the documentation; see the report."


def fill_blocks(text: str) -> str:
    """Replace all blocks of ``text``."""
    reports = Reports()
    return MARK.sub(lambda mark: f"{mark[1]}{text_of(mark[2], reports)}\n{mark[3]}", text)


def fill_pages() -> None:
    """Update all pages; print the names of those that changed."""
    for page in PAGES:
        old = page.read_text(encoding="utf-8")
        if (new := fill_blocks(old)) != old:
            replace_file(page, new.encode())
            print(page.relative_to(ROOT))
