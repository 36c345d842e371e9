"""The code in the documentation runs as it stands, and what it names is there."""

import re
import runpy
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
TEXT = (ROOT / "docs" / "extending.md").read_text(encoding="utf-8")
INTRODUCTION, *SECTIONS = re.split(r"^## ", TEXT, flags=re.MULTILINE)


@pytest.mark.parametrize("section", SECTIONS, ids=[s.splitlines()[0] for s in SECTIONS])
def test_a_section_runs_as_one_script(section, tmp_path):
    blocks = re.findall(r"^```python\n(.*?)^```", section, flags=re.MULTILINE | re.DOTALL)
    assert blocks
    script = tmp_path / "script.py"
    script.write_text("\n".join(blocks), encoding="utf-8")
    runpy.run_path(str(script), run_name="__main__")


def test_files_of_the_table_exist():
    rows = [line for line in INTRODUCTION.splitlines() if line.startswith("| ")]
    assert len(rows) > 5
    for name in re.findall(r"`([\w/]+(?:/|\.py))`", "\n".join(rows)):
        assert (ROOT / name if "/" in name else ROOT / "sim" / "energies" / name).exists(), name
