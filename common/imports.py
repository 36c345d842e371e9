"""The project's modules: what they import, and their code without comments and docstrings."""

import ast
import re
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

PACKAGES = ("apps", "benchmarks", "common", "data", "drapenet", "experiments", "sim")
SCRIPTS = ("train", "infer", "serve")

_STRING = rb"""
    "{3} [^"\\]* (?: (?: \\. | "(?!"") ) [^"\\]* )* "{3} | " [^"\\\n]* (?: \\. [^"\\\n]* )* "
  | '{3} [^'\\]* (?: (?: \\. | '(?!'') ) [^'\\]* )* '{3} | ' [^'\\\n]* (?: \\. [^'\\\n]* )* '"""
_BLANK = re.compile(rb"(" + _STRING + rb") | \s*\#[^\n]* | \s+(?=\n|\Z)", re.DOTALL | re.VERBOSE)
"""A string, or a comment or blanks and blank lines outside of strings."""


@dataclass(frozen=True)
class Module:
    """A module of Python by its dotted name, and its file, of a package ``__init__.py``."""

    name: str
    file: Path

    def imports(self, known: Collection[str]) -> set[str]:
        """Modules among ``known`` that it imports, also within functions and for type checkers."""
        package = self.name.split(".")[: None if self.file.name == "__init__.py" else -1]
        found: set[str] = set()
        for level, base, names in self._read[0]:
            above = package[: len(package) + 1 - level] if level else []
            base = ".".join([*above, base]).rstrip(".")
            # An imported name is a module, or is defined in the named module.
            found |= {inner if (inner := f"{base}.{name}") in known else base for name in names}
        return found.intersection(known)

    @property
    def code(self) -> bytes:
        """Its code without docstrings, comments, blank lines and blanks at the ends of lines: the
        same text in all versions of Python."""
        return self._read[1]

    @cached_property
    def _read(self) -> tuple[list[tuple[int, str, list[str]]], bytes]:
        """Level, module and names of each import, and the code."""
        # The tree is not kept: Python's collection of garbage would walk all of them again.
        return _read(self.file.read_bytes())


def plain_code(source: bytes) -> bytes:
    """Python code as :attr:`Module.code` has it."""
    return _read(source)[1]


def _read(source: bytes) -> tuple[list[tuple[int, str, list[str]]], bytes]:
    starts = [0]
    for line in source.splitlines(keepends=True):
        starts.append(starts[-1] + len(line))
    imports: list[tuple[int, str, list[str]]] = []
    parts, end = [], 0
    for node in _within(ast.parse(source)):
        if isinstance(node, ast.Import):
            imports += [(0, alias.name, [""]) for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            imports.append((node.level, node.module or "", [alias.name for alias in node.names]))
        elif isinstance(node, ast.Expr) and isinstance(text := node.value, ast.Constant) and (
                isinstance(text.value, str)):
            parts.append(source[end : starts[text.lineno - 1] + text.col_offset])
            end = starts[(text.end_lineno or 0) - 1] + (text.end_col_offset or 0)
    code = _BLANK.sub(lambda match: match[1] or b"", b"".join([*parts, source[end:]])).strip()
    return imports, code


def _within(node: ast.AST) -> Iterator[ast.stmt]:
    """All statements in their order."""
    for field in ("body", "handlers", "orelse", "finalbody", "cases"):
        for inner in getattr(node, field, ()):
            if isinstance(inner, ast.stmt):
                yield inner
            yield from _within(inner)


def modules(root: Path) -> dict[str, Module]:
    """All modules of the project in the folder ``root`` by name."""
    files = [file for package in PACKAGES for file in (root / package).rglob("*.py")]
    files += [file for script in SCRIPTS if (file := root / f"{script}.py").exists()]
    found = {}
    for file in files:
        parts = file.relative_to(root).with_suffix("").parts
        name = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
        found[name] = Module(name, file)
    return found


def closure(names: Iterable[str], known: Mapping[str, Module]) -> list[Module]:
    """The modules ``names`` and all among ``known`` that they import, directly or not, by name."""
    waiting = list(names)
    found = set(waiting)
    while waiting:
        new = known[waiting.pop()].imports(known) - found
        found |= new
        waiting += new
    return [known[name] for name in sorted(found)]
