"""The sentences of findings: each is used, and each use has its sentence with its values."""

import ast
import re
import string
from pathlib import Path

import pytest

from common.findings import Finding, sentences

ROOT = Path(__file__).parents[2]
TREES = {file: ast.parse(file.read_text("utf-8")) for room in ("apps", "data", "drapenet")
         for file in (ROOT / room).rglob("*.py")}
MAKERS = {"Finding", "_attempt", "_beyond", "_twin"}
"""Functions whose arguments name codes."""
LATER = {"file"}
"""Values that are put in where all findings of a file are gathered."""


def fields_of(code: str) -> set[str]:
    """The names of the values in a sentence."""
    return {re.split(r"\W", name)[0]
            for _, name, _, _ in string.Formatter().parse(sentences()[code]) if name}


@pytest.mark.parametrize("code", sentences())
def test_every_sentence_is_used_and_gives_a_line(code):
    assert any(isinstance(node, ast.Constant) and node.value == code
               for tree in TREES.values() for node in ast.walk(tree)), "nothing makes it"
    parts = [(name, spec) for _, name, spec, _ in string.Formatter().parse(sentences()[code])
             if name and "[" not in name]
    values = {name: 12.5 if spec else "x" for name, spec in parts} | {"first": {"text": "x"}}
    found = Finding(code, values, "source")
    assert re.search("[:;,] ", found.text) and len(found.text.splitlines()) == 1
    assert ("12" in found.text or "13" in found.text or "1e+01" in found.text) or not any(
        spec for _, spec in parts)
    assert found.record == {"code": code, "source": "source", "text": found.text, "values": values}


def test_a_number_that_is_not_finite_is_kept_as_none():
    record = Finding("pixel_large", {"value": float("inf"), "limit": 1.5}).record
    assert record["values"] == {"value": None, "limit": 1.5}
    assert "covers nan mm" in Finding(record["code"], record["values"]).text


def test_every_code_has_a_sentence_with_its_values():
    calls = [node for tree in TREES.values() for node in ast.walk(tree)
             if isinstance(node, ast.Call) and getattr(node.func, "id", "") in MAKERS]
    assert len(calls) > 80
    for call in calls:
        first, *others = call.args
        if isinstance(first, ast.Subscript):  # the code of a record
            continue
        named = [node.value for argument in (first, *others * (call.func.id != "Finding"))
                 for node in ast.walk(argument) if isinstance(node, ast.Constant)
                 and isinstance(node.value, str)]
        assert set(named) <= sentences().keys(), ast.unparse(call)
        values = others[0] if others else ast.Dict([], [])
        if call.func.id == "Finding" and isinstance(values, ast.Dict):
            given = {key.value for key in values.keys if isinstance(key, ast.Constant)}
            for code in named:
                assert fields_of(code) - LATER <= given, ast.unparse(call)
