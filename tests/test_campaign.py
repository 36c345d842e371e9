"""The campaign runs, a few cases of each kind, and the documentation shows its report."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


@pytest.mark.slow
def test_a_short_campaign_finds_nothing_and_goes_on(tmp_path: Path) -> None:
    for count in (2, 3):
        words = [f"corrupted={count}", f"kills={2 * count}", "pool_kills=1", "training_kills=1",
                 "accidents=1", f"work={tmp_path / 'work'}", f"out={tmp_path / 'report.json'}"]
        subprocess.run([sys.executable, "tests/campaign", *words], cwd=ROOT, check=True)
        found = json.loads((tmp_path / "report.json").read_text())
        assert all(one["cases"] == count and not one["findings"]
                   for one in found["readers"].values())
        assert all(one["runs"] == one["same"] > 0 for one in found["kills"].values())
        assert not any(one["wrong"] for one in found["accidents"].values())


def test_the_documentation_shows_the_report() -> None:
    code = ("import sys, json; sys.path[:0] = ['.', 'tests/campaign']; import tables; "
            "print(tables.describe(json.load(open('docs/validation/campaign.json'))))")
    shown = subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=True, capture_output=True,
                           text=True).stdout
    assert shown.strip() in (ROOT / "docs" / "validation.md").read_text(encoding="utf-8")
