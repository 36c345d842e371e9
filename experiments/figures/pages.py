"""Blocks by name, and the pages that they are part of."""

import re
from collections.abc import Callable

from common.errors import InputError
from experiments.figures import claims, of_drapes, of_estimates
from experiments.figures.reports import Reports
from experiments.result import ROOT, Report

PAGES = (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")))
MARK = re.compile(r"(<!-- figures: (\w+) -->\n).*?(<!-- end -->)", re.DOTALL)
BLOCKS: dict[str, Callable[[Reports], str]] = {
    block.__name__: block for block in (
        claims.claims, of_estimates.demo, of_estimates.fifteen_minutes, of_estimates.accuracy,
        of_estimates.views, of_estimates.strip_photographs, of_estimates.tension,
        of_estimates.mats, of_estimates.photographed, of_estimates.cells,
        of_estimates.refinement, of_estimates.bands, of_drapes.outlines, of_drapes.laboratory)
}


def shown(name: str, report: Report) -> str:
    """The claims and the block of an experiment, from a new report."""
    reports = Reports()
    try:
        reports.add(name, report)
        parts = [f"{claim.partition('](')[0].lstrip('[')}: {text} (target: {target})"
                 for claim, text, target, _ in claims.claim_rows(reports, name)]
        return "\n".join([*parts, BLOCKS[name](reports)] if name in BLOCKS else parts)
    except (KeyError, IndexError, TypeError, ValueError, ZeroDivisionError, StopIteration):
        return "The settings are too small for the claims of the documentation; see the report."


def fill_blocks(text: str) -> str:
    """Replace all blocks of ``text``."""
    reports = Reports()

    def block(mark: re.Match[str]) -> str:
        if mark[2] not in BLOCKS:
            raise InputError(f"figures: {mark[2]} is not a block; known: {', '.join(BLOCKS)}")
        return f"{mark[1]}{BLOCKS[mark[2]](reports)}\n{mark[3]}"

    return MARK.sub(block, text)
