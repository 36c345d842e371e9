"""Shared by the benchmarks: machine description, reports, figures and resumable cases."""

import hashlib
import inspect
import json
import os
import platform
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import as_completed
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from common.errors import InputError
from common.files import replace_file, replace_json, replacing
from common.provenance import package_versions, processor
from common.workers import worker_pool
from sim.drape import FINE_OPTIONS, scene_on
from sim.equilibrium import Equilibrium, find_equilibrium
from sim.laws import Laws
from sim.material import Fabric
from sim.mesh.specimens import Specimen
from sim.scene import Rig
from sim.start import interpolate_positions

if TYPE_CHECKING:
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure

ESTIMATOR_SOURCES = ("sim", "data", "drapenet")
"""Sources that results of estimates and refinements depend on, see :func:`run_cases`."""
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


def run_cases(
    work: Callable[..., dict],
    cases: dict[str, dict],
    *,
    folder: Path,
    workers: int = 1,
    sources: Sequence[str] = ("sim",),
) -> dict[str, dict]:
    """Run ``work(**settings)`` for every case that has no valid result in ``folder``.

    Each finished case is stored as ``folder/NAME.json`` with its settings and a digest of the
    sources that it depends on. A result of other settings or sources is recomputed, so that an
    interrupted run resumes and results of different versions are never mixed.

    Args:
        work: module-level function; returns a dictionary of JSON types, with an optional entry
            "arrays" of arrays by name, stored as ``folder/NAME.npz`` (:func:`load_arrays`).
        cases: keyword arguments of ``work``, of JSON types, by name of the case.
        workers: number of processes, one thread each.
        sources: folders and files of sources that the results depend on, in addition to ``work``;
            "drapenet" includes the bundled weights.

    Returns:
        Results by name, in the order of ``cases``.

    Raises:
        InputError: a worker was killed, or the folder cannot be written.
    """
    digest = sources_digest(sources, work)
    # Converted by JSON, so that tuples and numbers compare equal to those read from a file.
    stamps = {
        name: json.loads(json.dumps({"settings": settings, "sources": digest}))
        for name, settings in cases.items()
    }
    results = {name: _stored(folder / f"{name}.json", stamps[name]) for name in cases}
    missing = [name for name in cases if results[name] is None]
    if not missing:
        return results
    if workers < 1:
        raise InputError(f"workers={workers}: at least one process is needed")
    print(f"{len(cases) - len(missing)} of {len(cases)} cases are finished; "
          f"{len(missing)} to go", flush=True)
    with worker_pool(min(workers, len(missing))) as pool:
        futures = {pool.submit(work, **cases[name]): name for name in missing}
        for future in as_completed(futures):
            name = futures[future]
            results[name] = future.result()
            _store(folder / f"{name}.json", stamps[name], results[name])
            print(f"  {name}", flush=True)
    return results


def _store(path: Path, stamp: dict, result: dict) -> None:
    """Write a finished case, its arrays first, so that a JSON file always has its arrays."""
    if arrays := result.pop("arrays", None):
        with replacing(path.with_suffix(".npz")) as file:
            np.savez_compressed(file, **arrays)
    text = json.dumps({**stamp, "result": result}, indent=1, allow_nan=False) + "\n"
    replace_file(path, text.encode())


def load_arrays(folder: Path, name: str) -> dict[str, np.ndarray]:
    """Arrays by name of a finished case of :func:`run_cases`."""
    with np.load(folder / f"{name}.npz", allow_pickle=False) as file:
        return dict(file)


def _stored(path: Path, stamp: dict) -> dict | None:
    """Result stored in ``path``, None if missing or of other settings or sources."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        return content["result"] if all(content[k] == v for k, v in stamp.items()) else None
    except (OSError, ValueError, KeyError, TypeError):
        return None


def sources_digest(folders: Sequence[str], work: Callable) -> str:
    """Digest, 16 hexadecimal digits, of the sources in ``folders`` (or files) and of ``work``."""
    digest = hashlib.sha256(inspect.getsource(work).encode())
    files = {ROOT / name for name in folders if (ROOT / name).is_file()}
    files |= {file for folder in folders for kind in ("py", "json", "safetensors")
              for file in (ROOT / folder).rglob(f"*.{kind}")}
    for file in sorted(files):
        digest.update(file.relative_to(ROOT).as_posix().encode() + b"\0" + file.read_bytes())
    return digest.hexdigest()[:16]


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
