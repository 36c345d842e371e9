"""Check documentation, messages and docstrings for words to avoid: ``make lint``.

:data:`WORDS` gives a usual word for each.
"""

import re
import subprocess
import sys
from pathlib import Path

WORDS = {
    r"tells?|told": "identifies, distinguishes, reports",
    r"put down": "placed",
    r"anew": "again",
    r"errs": "has a bias of",
    r"hardly": "little, nearly",
    r"(?:is|are) no (?:number|plate|drape|capture|scan|prior|estimate|dataset|strip)s?": "is not a",
    r"(?:mesh|folder|name|start)s? of (?:its|their) own": "another, unique",
}
KINDS = ("*.py", "*.md", "*.yaml", "*.html", "*.ipynb", "Makefile")
ELSEWHERE = ("docs/studies.md", "tests/common/test_lint.py", "tools/check_words.py")
"""Excluded: a generated page, this list and its test."""


def complaints(root: Path) -> list[str]:
    """One line for each word to avoid in the files tracked by git in ``root``."""
    command = ["git", "-C", str(root), "ls-files", "--", *KINDS]
    names = subprocess.run(command, check=True, capture_output=True, text=True).stdout.split("\n")
    lines = []
    for name in filter(None, names):
        if name in ELSEWHERE:
            continue
        text = (root / name).read_text(encoding="utf-8")
        for pattern, usual in WORDS.items():
            for found in re.finditer(rf"(?<![\w.\"])(?:{pattern})\b(?!\()", text):
                line = text.count("\n", 0, found.start()) + 1
                lines.append(f"{name}:{line}: '{found[0]}': better: {usual}")
    return lines


if __name__ == "__main__":
    found = complaints(Path(__file__).resolve().parents[1])
    print("\n".join(found))
    sys.exit(bool(found))
