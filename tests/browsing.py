"""The page in a browser, as tests see it. Screenshots go to $DRAPENET_SCREENS."""

import os
from pathlib import Path

import pytest
from serving import EXAMPLE

from drapenet.network.checkpoint import BUNDLED

IN_BROWSER = [pytest.mark.browser,
              pytest.mark.skipif(not BUNDLED.exists(), reason="no network is bundled")]
FILES = [str(file) for file in (*sorted(EXAMPLE.glob("*.png")), EXAMPLE / "capture.yaml")]
SECONDS = 180_000  # ms: a cold start of the worker takes a minute on a busy machine


def keep(page, name: str, *, whole: bool = True) -> None:
    folder = Path(os.environ.get("DRAPENET_SCREENS", "outputs/browser"))
    folder.mkdir(parents=True, exist_ok=True)
    page.screenshot(path=str(folder / name), full_page=whole)


def unfold(page) -> None:
    page.evaluate("for (const fold of document.querySelectorAll('details:not(#cards *)')) "
                  "fold.open = true")


def fits(page, name: str = "") -> bool:
    """Whether nothing is wider than a phone, of which ``name`` is a screenshot."""
    page.set_viewport_size({"width": 390, "height": 844})
    page.wait_for_timeout(300)
    if name:
        keep(page, name)
    widths = page.evaluate("[document.documentElement, ...document.querySelectorAll('main section "
                           "*')].map((part) => part.scrollWidth > 390 ? part.outerHTML : '')")
    return not any(widths)


def saved(page, button: str) -> tuple[str, bytes]:
    """Name and content of what a button saves."""
    with page.expect_download() as download:
        page.click(button)
    return download.value.suggested_filename, Path(download.value.path()).read_bytes()
