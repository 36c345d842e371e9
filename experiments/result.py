"""Results of experiments: report, figure and tables, and cases that an interrupted run resumes.

An experiment is a module with ``run(config) -> Result`` in a folder of this package, and its keys
in ``configs/experiment/NAME.yaml``; a section of docs/studies.md is a ``SECTION``
(:mod:`experiments.page`).
"""

import json
import os
import platform
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from common import cases as resumable
from common.cases import load_arrays as load_arrays
from common.configs import group_options
from common.files import replace_json, replacing
from common.provenance import package_versions, processor

if TYPE_CHECKING:
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure

ROOT = Path(__file__).resolve().parents[1]
REPORTS = ROOT / "docs" / "validation"
FOLDERS = ("physics", "speed", "estimation", "papers")
FILES = {name: file for folder in FOLDERS for name in group_options("experiment")
         if (file := Path(__file__).parent / folder / f"{name}.py").is_file()}
"""Modules of the experiments by name, ordered by folder."""
SIMULATOR, ESTIMATOR = ("sim",), ("sim", "data", "drapenet")
"""Sources that results of simulations, and of estimates, depend on; see :func:`run_cases`."""
EXECUTION_KEYS = ("workers", "cases", "work", "out")
"""Settings that do not change a report."""

Config = dict[str, Any]
"""Settings of an experiment."""
Report = dict[str, Any]
"""Report of an experiment, of JSON types."""


class Result(NamedTuple):
    """Result of an experiment."""

    report: Report
    figure: "Figure | None" = None


def machine() -> dict:
    """Processor, number of cores and versions of packages."""
    return {
        "processor": processor(),
        "cores": os.cpu_count(),
        "python": platform.python_version(),
        **package_versions("numpy", "numba", "scipy", "torch"),
    }


def write_report(path: Path, content: Report) -> None:
    """Write a report and the machine."""
    replace_json(path, {"machine": machine(), **content})


def read_report(name: str) -> Report:
    """The stored report of an experiment."""
    return json.loads((REPORTS / f"{name}.json").read_text(encoding="utf-8"))


def write_figure(path: Path, figure: "Figure") -> None:
    """Write a figure as PNG."""
    with replacing(path) as file:
        figure.savefig(file, format="png", dpi=110)


def label_log_axes(*scales: "Axis") -> None:
    """Label logarithmic axes that span about one decade at 1, 2 and 5, with plain numbers."""
    from matplotlib.ticker import LogLocator, NullFormatter

    for scale in scales:
        scale.set_major_locator(LogLocator(subs=(1, 2, 5)))
        scale.set_major_formatter("{x:g}")
        scale.set_minor_formatter(NullFormatter())


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


def rms(values: np.ndarray | list) -> float:
    """Root mean square."""
    return float(np.sqrt(np.square(values).mean()))


def run_cases(
    work: Callable[..., dict], cases: dict[str, dict], config: Config, *,
    sources: Sequence[str] = SIMULATOR, folder: Path | None = None,
) -> dict[str, dict]:
    """Results by name, see :func:`common.cases.run_cases`; of the folder ``config["cases"]``."""
    return resumable.run_cases(work, cases, folder=folder or Path(config["cases"]),
                               workers=config.get("workers", 1), sources=sources)


def run_fabrics(
    case: Callable[..., dict], config: Config, *, sources: Sequence[str] = ESTIMATOR,
    subfolder: str = "",
) -> dict[str, dict]:
    """Run ``case(number=k, ...)`` for every fabric, with the keys of ``config`` that change it."""
    others = (*EXECUTION_KEYS, "fabrics")
    settings = {key: value for key, value in config.items() if key not in others}
    return run_cases(case, {f"fabric_{k:02}": settings | {"number": k}
                            for k in range(config["fabrics"])},
                     config, folder=Path(config["cases"]) / subfolder, sources=sources)
