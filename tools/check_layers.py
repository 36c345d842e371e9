"""Check imports of modules: ``python tools/check_layers.py`` (``make lint``).

There are no import cycles, including imports in functions and for type checkers; lower packages do
not import higher ones.
"""

import ast
import sys
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

PACKAGES = ("apps", "common", "data", "drapenet", "sim")
SCRIPTS = ("train", "infer", "serve")
FORBIDDEN = {
    "common": ("apps", "data", "drapenet", "sim", *SCRIPTS),
    "sim": ("apps", "data", "drapenet", *SCRIPTS),
    "data": ("apps", "drapenet", *SCRIPTS),
    "drapenet": ("apps", *SCRIPTS),
}
"""What a package must not import."""


def modules(root: Path) -> dict[str, Path]:
    """Files of all modules by dotted name; packages have their ``__init__.py``."""
    files = [file for package in PACKAGES for file in (root / package).rglob("*.py")]
    files += [file for script in SCRIPTS if (file := root / f"{script}.py").exists()]
    parts = {file: file.relative_to(root).with_suffix("").parts for file in files}
    return {".".join(p[:-1] if p[-1] == "__init__" else p): file for file, p in parts.items()}


def imports(name: str, file: Path, known: set[str]) -> set[str]:
    """Modules among ``known`` that the module ``name`` imports, also within functions."""
    found = set()
    package = name.split(".")[: None if file.name == "__init__.py" else -1]
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            above = package[: len(package) + 1 - node.level] if node.level else []
            base = ".".join([*above, *filter(None, [node.module])])
            # The imported name is a module, or is defined in the named module.
            found |= {inner if (inner := f"{base}.{alias.name}") in known else base
                      for alias in node.names}
    return found & known


def complaints(root: Path) -> list[str]:
    """One line for each violation in the project in the folder ``root``."""
    files = modules(root)
    graph = {name: imports(name, file, set(files)) for name, file in sorted(files.items())}
    lines = []
    for name, others in graph.items():
        package = name.partition(".")[0]
        lines += [f"{name} imports {other}: {package} must not" for other in sorted(others)
                  if other.partition(".")[0] in FORBIDDEN.get(package, ())]
    while True:
        try:
            TopologicalSorter(graph).prepare()
            return lines
        except CycleError as error:
            circle = error.args[1][::-1]  # each imports the next
            lines.append("import circle: " + " -> ".join(circle))
            graph[circle[0]] = graph[circle[0]] - {circle[1]}  # removed to find other cycles


if __name__ == "__main__":
    found = complaints(Path(__file__).resolve().parents[1])
    for line in found:
        print(line)
    sys.exit(bool(found))
