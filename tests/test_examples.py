"""The code in the documentation runs as it stands, and what it names is there."""

import re
import runpy
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
TEXT = (ROOT / "docs" / "extending.md").read_text(encoding="utf-8")
SECTIONS = {part.splitlines()[0]: part for part in re.split(r"^## ", TEXT, flags=re.MULTILINE)[1:]}
SCRIPTS = [name for name, part in SECTIONS.items() if "```python" in part]
FOLDERS = [ROOT, ROOT / "drapenet", ROOT / "data" / "captures", ROOT / "sim" / "energies"]
"""In which the names of files in the text are relative."""


@pytest.mark.parametrize("name", SCRIPTS)
def test_a_section_runs_as_one_script(name, tmp_path):
    blocks = re.findall(r"^```python\n(.*?)^```", SECTIONS[name], flags=re.MULTILINE | re.DOTALL)
    script = tmp_path / "script.py"
    script.write_text("\n".join(blocks), encoding="utf-8")
    runpy.run_path(str(script), run_name="__main__")


def test_files_that_are_named_exist():
    names = re.findall(r"`([\w/]+(?:/|\.py))`", TEXT)
    assert len(names) > 10
    for name in names:
        assert any((folder / name).exists() for folder in FOLDERS), name
