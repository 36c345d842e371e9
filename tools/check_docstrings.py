"""Check that docstrings of public functions give units and shapes: ``make lint``.

A parameter named for a quantity needs one of its units (:data:`UNITS`), an array in a signature
needs a shape such as ``(V, 3)``, in the docstring of the function, its class or its module, or a
type of :mod:`common.types`, which states both. A method without a docstring in a derived class has
that of its base. A docstring may refer to another for its arguments: "see", "as for" or "as in" and
a role, such as ``:func:``.
"""

import ast
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

PACKAGES = ("apps", "common", "data", "drapenet", "sim")
LENGTH, ANGLE = r"\bm\b|\bmm\b|\bpixels?\b", r"\bdegrees?\b|\brad(?:ians?)?\b|°"
UNITS = {
    "alpha": r"N·m", "alphas": r"N·m", "beta": r"N·m²", "betas": r"N·m²", "moduli": r"N·m",
    "stiffness": r"\bN\b|N/m", "torque": r"\bN\b|N·m", "force": r"\bN\b", "energy": r"\bJ\b",
    "density": r"kg/m²|g/m²", "curvature": r"1/m", "curvatures": r"1/m",
    "turn": ANGLE, "turns": ANGLE, "angle": ANGLE, "angles": ANGLE,
    "radius": LENGTH, "height": LENGTH, "width": LENGTH, "length": LENGTH, "thickness": LENGTH,
    "edge": LENGTH, "distance": LENGTH, "distances": LENGTH, "depth": LENGTH, "points": LENGTH,
}
SUFFIXES = {"mm", "deg", "degrees", "unit", "scale", "standardised"}
"""Last parts of names that give the unit or that have none."""
SHAPE = re.compile(r"\((?:[\w ]+|\.{3})(?:, ?(?:[\w ]+|\.{3}))*,?\)|shape")
REFERENCE = re.compile(
    r"\b(?:see|as for|as in|are|as|attributes of)\s:(?:class|func|meth|mod):", re.I)


def functions(body: list[ast.stmt], context: str, derived: bool
              ) -> Iterator[tuple[ast.FunctionDef, str]]:
    """Public functions and methods with the text that documents them."""
    for node in body:
        name = getattr(node, "name", "_")
        if name.startswith("_"):
            continue
        text = ast.get_docstring(node) or ""
        if isinstance(node, ast.ClassDef):
            yield from functions(node.body, f"{context}\n{text}", bool(node.bases))
        elif isinstance(node, ast.FunctionDef) and (text or not derived):
            yield node, f"{context}\n{text}"


def complaints(path: Path) -> list[str]:
    """One line for each public function of a file without units or shapes."""
    tree, lines = ast.parse(path.read_text(encoding="utf-8")), []
    for node, text in functions(tree.body, ast.get_docstring(tree) or "", derived=False):
        place = f"{path}:{node.lineno}: {node.name}"
        if REFERENCE.search(text):
            continue
        arguments = [a for a in (*node.args.args, *node.args.kwonlyargs) if a.annotation]
        kinds = [ast.unparse(item) for item in (*(a.annotation for a in arguments), node.returns)
                 if item]
        for argument, kind in zip(arguments, kinds, strict=False):
            parts = argument.arg.split("_")
            unit = UNITS.get(parts[-1]) if not SUFFIXES & set(parts) else None
            if unit and re.search("float|ndarray|Tensor", kind) and not re.search(
                    f"{unit}|standardised", text):
                lines.append(f"{place}: no unit of {argument.arg}")
        if any(re.search(r"ndarray|Tensor\b", kind) for kind in kinds) and not SHAPE.search(text):
            lines.append(f"{place}: no shape of its arrays, such as (V, 3)")
    return lines


if __name__ == "__main__":
    listed = subprocess.run(["git", "ls-files", "--", *PACKAGES], check=True, capture_output=True,
                            text=True).stdout.split()
    found = [line for name in listed if name.endswith(".py") for line in complaints(Path(name))]
    print("\n".join(found))
    sys.exit(bool(found))
