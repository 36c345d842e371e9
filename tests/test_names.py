"""Public names: listed once for each package, there, and used by the documentation."""

import ast
import json
import re
import subprocess
import sys
from collections.abc import Iterator
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

import pytest

import drapenet
from tools import reference

ROOT = Path(__file__).resolve().parent.parent
SOURCES = [file for folder in ("apps", "common", "data", "drapenet", "sim")
           for file in sorted((ROOT / folder).rglob("*.py"))]
LISTED = [file for file in SOURCES if re.search(r"^__all__\b", file.read_text("utf-8"), re.M)]
DOCUMENTS = ["README.md", *(f"docs/{name}" for name in
                            ("data_format.md", "extending.md", "gallery.md", "use.md",
                             "tutorial.ipynb", "garment.ipynb", "gradients.ipynb"))]


def test_names_are_listed_where_a_package_begins():
    assert {file.name for file in LISTED} == {"__init__.py"}
    packages = {".".join(file.parent.relative_to(ROOT).parts) for file in LISTED}
    assert packages >= {"sim", "sim.energies", "sim.solver", "sim.mesh", "sim.sensitivity",
                        "sim.cantilever", "data.readings", "drapenet"}


@pytest.mark.parametrize("file", LISTED, ids=lambda file: file.parent.name)
def test_each_listed_name_is_there_once(file):
    module = import_module(".".join(file.parent.relative_to(ROOT).parts))
    names = module.__all__
    assert names == sorted(set(names), key=lambda name: (not name.isupper(), name.islower(), name))
    assert set(names) <= set(dir(module)) and not any(name.startswith("_") for name in names)


def imports(text: str) -> Iterator[tuple[str, str]]:
    """Modules and names of all ``from MODULE import NAME`` of this project in a script."""
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.ImportFrom) and node.module.split(".")[0] in (
                "sim", "data", "drapenet", "common"):
            yield from ((node.module, alias.name) for alias in node.names)


@pytest.mark.parametrize("name", DOCUMENTS)
def test_documents_import_public_names_or_from_modules(name):
    text = (ROOT / name).read_text("utf-8")
    scripts = (["".join(cell["source"]) for cell in json.loads(text)["cells"]
                if cell["cell_type"] == "code"] if name.endswith("ipynb") else
               re.findall(r"^```python\n(.*?)^```", text, re.M | re.DOTALL))
    for module, item in (each for script in scripts for each in imports(script)):
        found = import_module(module)
        assert item in getattr(found, "__all__", ()) or not hasattr(found, "__path__") or find_spec(
            f"{module}.{item}"), f"from {module} import {item}"


@pytest.mark.parametrize("name", [name for name in DOCUMENTS if name.endswith("ipynb")])
def test_outputs_of_notebooks_are_stored_and_small(name):
    file = ROOT / name
    cells = [cell for cell in json.loads(file.read_text("utf-8"))["cells"]
             if cell["cell_type"] == "code"]
    assert [cell["execution_count"] for cell in cells] == list(range(1, len(cells) + 1))
    assert all(cell["outputs"] for cell in cells)
    assert file.stat().st_size < 300_000


def test_the_simulator_loads_without_what_only_networks_and_reports_need():
    code = ("import sys, sim; from sim import Fabric, Laws, Rig, drape; assert callable(drape);"
            "print({'torch', 'open3d', 'matplotlib', 'hydra', 'cv2'} & set(sys.modules))")
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT)
    assert done.stdout == "set()\n", done.stdout + done.stderr


def test_the_reference_has_a_page_of_each_public_name(tmp_path):
    reference.main(tmp_path, show_source=False)
    page = (tmp_path / "drapenet.html").read_text("utf-8")
    for name in drapenet.__all__:
        assert f'id="{name}"' in page
    assert (tmp_path / "data" / "captures.html").exists()
