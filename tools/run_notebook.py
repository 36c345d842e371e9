"""Run a notebook's code cells as one script, store their output: ``tools/run_notebook.py FILE``.

The printed text and the matplotlib figures (PNG) of each cell are stored. Jupyter is not needed,
and equal results give equal files.
"""

import base64
import contextlib
import io
import json
import sys
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt

DPI = 60


def run(path: Path) -> dict:
    """Notebook in ``path`` with the outputs of its cells; exceptions of cells are raised."""
    notebook = json.loads(path.read_text(encoding="utf-8"))
    names: dict = {"__name__": "__main__"}
    number = 0
    for cell in notebook["cells"]:
        if cell["cell_type"] != "code":
            continue
        number += 1
        printed = io.StringIO()
        with contextlib.redirect_stdout(printed):
            exec(compile("".join(cell["source"]), f"{path.name}[{number}]", "exec"), names)
        cell["execution_count"] = number
        cell["outputs"] = [_text(printed.getvalue())] if printed.getvalue() else []
        cell["outputs"] += [_picture(plt.figure(k)) for k in plt.get_fignums()]
        plt.close("all")
    return notebook


def _text(printed: str) -> dict:
    return {"output_type": "stream", "name": "stdout", "text": printed.splitlines(keepends=True)}


def _picture(figure: plt.Figure) -> dict:
    file = io.BytesIO()
    figure.savefig(file, format="png", dpi=DPI, bbox_inches="tight", metadata={"Software": None})
    png = base64.b64encode(file.getvalue()).decode()
    return {"output_type": "display_data", "metadata": {}, "data": {"image/png": png}}


if __name__ == "__main__":
    file = Path(sys.argv[1])
    text = json.dumps(run(file), indent=1, ensure_ascii=False) + "\n"
    file.write_text(text, encoding="utf-8")
