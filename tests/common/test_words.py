"""``tools/check_words.py`` finds the words that it lists."""

import subprocess
import sys
from pathlib import Path

import common

SCRIPT = Path(common.__file__).parents[1] / "tools" / "check_words.py"


def test_listed_words_are_found_where_they_stand(tmp_path):
    (tmp_path / "tools").mkdir()
    (tmp_path / "tools" / SCRIPT.name).write_bytes(SCRIPT.read_bytes())
    (tmp_path / "page.md").write_text("A drape tells little.\n\nThat " "is no " "number.\n")
    (tmp_path / "module.py").write_text("strategy.tell(1)\nhard = 'a threshold'\n")
    (tmp_path / "unknown.md").write_text("hardly")
    for words in (("init", "-q"), ("add", "page.md", "module.py", "tools")):
        subprocess.run(["git", "-C", str(tmp_path), *words], check=True)
    done = subprocess.run([sys.executable, tmp_path / "tools" / SCRIPT.name],
                          capture_output=True, text=True)
    assert done.returncode == 1
    assert [line.split(": better")[0] for line in done.stdout.splitlines()] == [
        "page.md:1: 'tells'", "page.md:3: 'is no number'"]
