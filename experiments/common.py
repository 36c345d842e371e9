"""Shared by the benchmarks: machine description, reports, figures and resumable cases."""

import os
import platform
from collections.abc import Iterable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from common import cases
from common.cases import load_arrays as load_arrays
from common.files import replace_json, replacing
from common.provenance import package_versions, processor
from sim.cloth import Laws
from sim.drape import FINE_OPTIONS, scene_on
from sim.equilibrium import Equilibrium, find_equilibrium
from sim.material import Fabric
from sim.mesh.specimen import Specimen
from sim.rig import Rig
from sim.start import interpolate_positions

if TYPE_CHECKING:
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure

ESTIMATOR_SOURCES = ("sim", "data", "drapenet")
"""Sources that results of estimates and refinements depend on, see :func:`run_cases`."""
run_cases = partial(cases.run_cases, sources=("sim",))
"""Resumable cases, see :func:`common.cases.run_cases`."""
ROOT = Path(__file__).resolve().parents[1]
REPORTS = ROOT / "docs" / "validation"

Config = dict[str, Any]
"""Settings of a benchmark from ``configs/benchmark/NAME.yaml`` and the command line."""


class Result(NamedTuple):
    """Result of a benchmark: its report, of JSON types, and its figure."""

    report: dict[str, Any]
    figure: "Figure | None" = None


def machine() -> dict:
    """Processor, number of cores and versions of packages."""
    return {
        "processor": processor(),
        "cores": os.cpu_count(),
        "python": platform.python_version(),
        **package_versions("numpy", "numba", "scipy", "torch"),
    }


def write_report(path: Path, content: dict) -> None:
    """Write ``content`` and the machine description as JSON."""
    replace_json(path, {"machine": machine(), **content})


def write_figure(path: Path, figure: "Figure") -> None:
    """Write a matplotlib figure as PNG."""
    with replacing(path) as file:
        figure.savefig(file, format="png", dpi=110)


def label_log_axes(*scales: "Axis") -> None:
    """Label logarithmic axes that span about one decade at 1, 2 and 5, with plain numbers."""
    from matplotlib.ticker import LogLocator, NullFormatter

    for scale in scales:
        scale.set_major_locator(LogLocator(subs=(1, 2, 5)))
        scale.set_major_formatter("{x:g}")
        scale.set_minor_formatter(NullFormatter())


def equilibrium_near(
    rest: np.ndarray,
    positions: np.ndarray,
    specimen: Specimen,
    rig: Rig,
    fabric: Fabric,
    laws: Laws | None = None,
    *,
    self_contact: bool = False,
) -> Equilibrium:
    """Equilibrium of ``fabric`` on the mesh of ``specimen``, started from a drape on another mesh.

    Args:
        rest, positions: (W, 2) and (W, 3), m, of the drape to start from.
        fabric, laws, self_contact: as for :func:`sim.equilibrium.find_equilibrium`.
    """
    scene = scene_on(specimen, rig)
    flat, held = scene.mesh.rest, scene.held
    start = interpolate_positions(rest, positions, flat)
    start[held] = rig.place(flat[held])
    return find_equilibrium(scene, fabric, scene.state(start), laws=laws, options=FINE_OPTIONS,
                            self_contact=self_contact)


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
