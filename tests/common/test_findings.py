"""The sentences of findings: each is used, and each use has its sentence."""

import ast
import string
from pathlib import Path

from common.findings import Finding, sentences

ROOT = Path(__file__).parents[2]
NUMBERS = {"value", "expected", "limit"}


def test_every_sentence_is_used_and_gives_a_line():
    files = [file for room in ("data", "drapenet") for file in (ROOT / room).rglob("*.py")]
    named = {node.value for file in files for node in ast.walk(ast.parse(file.read_text("utf-8")))
             if isinstance(node, ast.Constant) and isinstance(node.value, str)}
    for code, sentence in sentences().items():
        assert code in named, f"nothing makes a finding {code}"
        fields = [name for _, name, _, _ in string.Formatter().parse(sentence) if name]
        line = Finding(code, {name: 12.5 if name in NUMBERS else "x" for name in fields}).text
        assert ("12.5" in line) == bool(NUMBERS & {*fields})
        assert ": " in line and len(line.splitlines()) == 1
