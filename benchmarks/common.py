"""What benchmarks share: the machine's description, reports, and work that can be resumed."""

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
from sim.initial import interpolate_positions
from sim.laws import Laws
from sim.material import Fabric
from sim.mesh.specimens import Specimen
from sim.scene import Rig

if TYPE_CHECKING:
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure

ESTIMATOR = ("sim", "data", "drapenet")
"""Sources of figures that an estimate or a refinement gives, see :func:`run_cases`."""
ROOT = Path(__file__).resolve().parents[1]
REPORTS = ROOT / "docs" / "validation"

Config = dict[str, Any]
"""Settings of a benchmark, those of ``configs/benchmark/NAME.yaml`` and the command line."""


class Result(NamedTuple):
    """What a benchmark finds: its report, in JSON's types, and its picture."""

    report: dict[str, Any]
    figure: "Figure | None" = None


def machine() -> dict:
    """Hardware and versions."""
    return {
        "processor": processor(),
        "cores": os.cpu_count(),
        "python": platform.python_version(),
        **package_versions("numpy", "numba", "scipy", "torch"),
    }


def write_report(path: Path, content: dict) -> None:
    """Write ``content`` and the machine's description as JSON."""
    replace_json(path, {"machine": machine(), **content})


def write_figure(path: Path, figure: "Figure") -> None:
    """Write a matplotlib figure as PNG."""
    with replacing(path) as file:
        figure.savefig(file, format="png", dpi=110)


def tick_short_scales(*scales: "Axis") -> None:
    """Label logarithmic scales little longer than a power of ten with plain numbers."""
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
    """Results of ``work(**settings)`` for every case, from ``folder`` where it is finished.

    Each case becomes ``folder/NAME.json`` as soon as it is done, with its settings and a digest
    of the sources that it depends on. A file of other settings or sources is made again; so an
    interrupted run goes on where it stopped, and old figures never mix with new ones.

    Args:
        work: a function at the top of a module; what it returns must be fit for JSON, but for
            an entry "arrays" of arrays by name, which become ``folder/NAME.npz``
            (:func:`load_arrays`).
        cases: keyword arguments of ``work`` by name of the case, fit for JSON.
        workers: processes, one thread each.
        sources: folders and files of sources that the figures depend on, beside ``work`` itself;
            with "drapenet", on the bundled weights as well.

    Returns:
        Results by name, in the order of ``cases``.

    Raises:
        InputError: a worker was ended from outside, or the folder cannot be written.
    """
    digest = sources_digest(sources, work)
    # Through JSON, so that tuples and numbers compare as they are read back.
    stamps = {
        name: json.loads(json.dumps({"settings": settings, "sources": digest}))
        for name, settings in cases.items()
    }
    results = {name: _finished(folder / f"{name}.json", stamps[name]) for name in cases}
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
            _keep(folder / f"{name}.json", stamps[name], results[name])
            print(f"  {name}", flush=True)
    return results


def _keep(path: Path, stamp: dict, result: dict) -> None:
    """Write a finished case, its arrays first, so that no JSON stands without them."""
    if arrays := result.pop("arrays", None):
        with replacing(path.with_suffix(".npz")) as file:
            np.savez_compressed(file, **arrays)
    text = json.dumps({**stamp, "result": result}, indent=1, allow_nan=False) + "\n"
    replace_file(path, text.encode())


def load_arrays(folder: Path, name: str) -> dict[str, np.ndarray]:
    """The arrays of a finished case of :func:`run_cases`."""
    with np.load(folder / f"{name}.npz", allow_pickle=False) as file:
        return dict(file)


def _finished(path: Path, stamp: dict) -> dict | None:
    """The result in ``path``, None if there is none for these settings and sources."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        return content["result"] if all(content[k] == v for k, v in stamp.items()) else None
    except (OSError, ValueError, KeyError, TypeError):
        return None


def sources_digest(folders: Sequence[str], work: Callable) -> str:
    """A short digest of the sources in ``folders``, files too, and of ``work``: figures of other
    sources are others."""
    digest = hashlib.sha256(inspect.getsource(work).encode())
    # A JSON stands beside the weights and has their digest.
    files = {ROOT / name for name in folders if (ROOT / name).is_file()}
    files |= {file for folder in folders for kind in ("py", "json")
              for file in (ROOT / folder).rglob(f"*.{kind}")}
    for file in sorted(files):
        digest.update(file.relative_to(ROOT).as_posix().encode() + b"\0" + file.read_bytes())
    return digest.hexdigest()[:16]


def next_to(
    rest: np.ndarray,
    positions: np.ndarray,
    specimen: Specimen,
    rig: Rig,
    fabric: Fabric,
    laws: Laws | None = None,
    *,
    self_contact: bool = False,
) -> Equilibrium:
    """The equilibrium of ``fabric`` on the mesh of ``specimen`` next to a drape on another one.

    Args:
        rest, positions: (W, 2) and (W, 3), m, of that drape.
        fabric, laws, self_contact: as for :func:`sim.equilibrium.find_equilibrium`.
    """
    scene = scene_on(specimen, rig)
    flat, held = scene.mesh.rest, scene.held
    start = interpolate_positions(rest, positions, flat)
    start[held] = rig.place(flat[held])
    return find_equilibrium(scene, fabric, scene.state(start), laws=laws, options=FINE_OPTIONS,
                            self_contact=self_contact)


def table(head: Iterable[str], rows: Iterable[Iterable[object]]) -> str:
    """Lines of a Markdown table; floats with three significant digits."""
    def cell(value: object) -> str:
        return f"{value:.3g}" if isinstance(value, float) else str(value)

    lines = [[cell(v) for v in head], *([cell(v) for v in row] for row in rows)]
    width = [max(len(line[k]) for line in lines) for k in range(len(lines[0]))]
    text = ["| " + " | ".join(v.ljust(w) for v, w in zip(line, width, strict=True)) + " |"
            for line in lines]
    text.insert(1, "|" + "|".join("-" * (w + 2) for w in width) + "|")
    return "\n".join(text)
