"""The code in the documentation runs as it stands, and what it names is there."""

import re
import runpy
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
TEXT = (ROOT / "docs" / "extending.md").read_text(encoding="utf-8")
MAP, WALK, *SECTIONS = re.split(r"^## ", TEXT, flags=re.MULTILINE)[1:]


@pytest.mark.parametrize("section", SECTIONS, ids=[s.splitlines()[0] for s in SECTIONS])
def test_a_section_runs_as_one_script(section, tmp_path):
    blocks = re.findall(r"^```python\n(.*?)^```", section, flags=re.MULTILINE | re.DOTALL)
    assert blocks
    script = tmp_path / "script.py"
    script.write_text("\n".join(blocks), encoding="utf-8")
    runpy.run_path(str(script), run_name="__main__")


@pytest.mark.parametrize("way", [MAP, WALK], ids=["project", "simulator"])
def test_a_way_is_ten_lines(way):
    lines = re.findall(r"^(\d+)\. .*`.*`", way, flags=re.MULTILINE)
    assert lines == [str(k) for k in range(1, 11)]


def test_files_that_are_named_exist():
    names = re.findall(r"`([\w/]+(?:/|\.py))`", TEXT)
    assert len(names) > 10
    for name in names:
        assert any((folder / name).exists() for folder in (ROOT, ROOT / "sim" / "energies")), name
