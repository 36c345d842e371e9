"""The notebooks' code runs, and its outputs are stored."""

import ast
import importlib.util
import json
import shutil
from pathlib import Path

import pytest

from common.configs import read_option

ROOT = Path(__file__).resolve().parents[1]
NOTEBOOKS = sorted((ROOT / "docs").glob("*.ipynb"))
WRITTEN = {"tutorial": "fabric.jfab", "garment": "garment.glb"}
each_notebook = pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda path: path.stem)


def code(notebook: dict) -> list[dict]:
    return [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]


@each_notebook
def test_outputs_are_stored_and_small(notebook):
    cells = code(json.loads(notebook.read_text(encoding="utf-8")))
    assert [cell["execution_count"] for cell in cells] == list(range(1, len(cells) + 1))
    assert all(cell["outputs"] for cell in cells)
    assert notebook.stat().st_size < 300_000


@each_notebook
def test_all_that_a_notebook_imports_and_all_options_that_it_reads_exist(notebook):
    for cell in code(json.loads(notebook.read_text(encoding="utf-8"))):
        for node in ast.walk(ast.parse("".join(cell["source"]))):
            if isinstance(node, ast.ImportFrom):
                module = importlib.import_module(node.module)
                assert all(hasattr(module, name.name) for name in node.names), node.module
            elif isinstance(node, ast.Call) and getattr(node.func, "id", "") == "read_option":
                assert read_option(*map(ast.literal_eval, node.args))


@pytest.mark.slow
@each_notebook
def test_a_notebook_runs_as_a_script(notebook, tmp_path, monkeypatch):
    spec = importlib.util.spec_from_file_location("run_notebook", ROOT / "tools/run_notebook.py")
    tool = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(tool)
    shutil.copy(notebook, tmp_path)
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    monkeypatch.chdir(tmp_path)
    cells = code(tool.run(tmp_path / notebook.name))  # its cells assert what they find
    assert [len(cell["outputs"]) for cell in cells] == [
        len(cell["outputs"]) for cell in code(json.loads(notebook.read_text(encoding="utf-8")))]
    if name := WRITTEN.get(notebook.stem):
        assert (tmp_path / "outputs" / notebook.stem / name).exists()
