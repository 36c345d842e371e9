"""Reports of studies, their figures and tables."""

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from common.files import replace_json
from common.provenance import machine
from drapenet.network.checkpoint import read_header

ROOT = Path(__file__).resolve().parents[1]
REPORTS = ROOT / "docs" / "validation"

Report = dict[str, Any]
"""Report of a study, of JSON types."""


def write_report(path: Path, content: Report) -> None:
    """Write a report, the machine and the bundled weights."""
    replace_json(path, {"machine": machine(), "weights_sha256": read_header().sha256, **content})


def read_report(name: str) -> Report:
    """The stored report of a study."""
    return json.loads((REPORTS / f"{name}.json").read_text(encoding="utf-8"))


def table(head: Iterable[str], rows: Iterable[Iterable[object]]) -> str:
    """Markdown table with aligned columns; floats have three significant digits."""
    def cell(value: object) -> str:
        return f"{value:.3g}" if isinstance(value, float) else str(value)

    lines = [[cell(v) for v in head], *([cell(v) for v in row] for row in rows)]
    width = [max(len(line[k]) for line in lines) for k in range(len(lines[0]))]
    text = ["| " + " | ".join(v.ljust(w) for v, w in zip(line, width, strict=True)) + " |"
            for line in lines]
    text.insert(1, "|" + "|".join("-" * (w + 2) for w in width) + "|")
    return "\n".join(text)


def markdown(head: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """Markdown table without aligned columns."""
    lines = [[*head], *(list(row) for row in rows)]
    lines.insert(1, ["---"] * len(lines[0]))
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def percents(shares: Iterable[float]) -> str:
    """Shares in percent in one cell of a table."""
    return ", ".join(f"{100 * share:.0f}" for share in shares)


def rms(values: np.ndarray | list) -> float:
    """Root mean square."""
    return float(np.sqrt(np.square(values).mean()))
