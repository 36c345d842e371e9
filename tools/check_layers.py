"""Check imports of modules: ``python tools/check_layers.py`` (``make lint``).

There are no import cycles, including imports in functions and for type checkers; lower packages do
not import higher ones.
"""

import sys
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

from common.imports import SCRIPTS, modules

FORBIDDEN = {
    "common": ("apps", "data", "drapenet", "sim", *SCRIPTS),
    "sim": ("apps", "data", "drapenet", *SCRIPTS),
    "data": ("apps", "drapenet", *SCRIPTS),
    "drapenet": ("apps", *SCRIPTS),
}
"""What a package must not import."""


def complaints(root: Path) -> list[str]:
    """One line for each violation in the project in the folder ``root``."""
    known = modules(root)
    graph = {name: known[name].imports(known) for name in sorted(known)}
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
