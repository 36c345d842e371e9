"""Resumable work: a case is done when its result file exists, with the key of the case.

The key is a digest of its settings and of the version of the work, a number beside its code that is
raised by hand when results change.

Trainings and shards of datasets are no cases: they are refused, not made again, where settings have
changed, because hours may be in them.
"""

import json
import sys
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import as_completed
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from common.errors import InputError, one_line
from common.files import remove_file, replace_file, replacing
from common.provenance import digest
from common.workers import worker_pool

# One process draws. tqdm's default lock is shared with forked processes, and stays locked if one of
# them is killed while it holds it.
tqdm.set_lock(threading.RLock())


def run_cases(
    work: Callable[..., Any],
    cases: Mapping[str, Mapping[str, Any]],
    *,
    folder: Path,
    workers: int = 1,
    version: object = 1,
    unit: str = "case",
) -> dict[str, Any]:
    """Results of ``work(**settings)`` by name; only those without a file are computed. The first
    error is raised when all other cases are done.

    Args:
        work: module-level function; returns JSON types. An entry "arrays" of a dictionary, arrays
            by name, is stored as ``folder/NAME.npz``, see :func:`load_arrays`.
        cases: settings by name, of JSON types, paths and dataclasses of these; a path stands for
            the content of the file or folder.
        folder: of the result files ``NAME.json``.
        version: of the code that makes the results; of JSON types.
    """
    keys = {name: digest([settings, version]) for name, settings in cases.items()}
    files = {name: folder / f"{name}.json" for name in cases}
    stored: dict[str, Any] = {name: _stored(files[name], keys[name]) for name in cases}
    tasks = {name: (work, cases[name], files[name], keys[name])
             for name in cases if stored[name] is None}
    errors = []
    for name, outcome in in_processes(_run, tasks, total=len(cases), workers=workers, unit=unit):
        stored[name] = outcome
        if isinstance(outcome, Exception):
            errors.append(outcome)
            tqdm.write(f"{name} failed: {one_line(outcome)}")
    if errors:
        raise errors[0]
    return {name: case["result"] for name, case in stored.items()}


def in_processes(
    work: Callable[..., Any], tasks: Mapping[Any, Sequence[Any]], *, total: int, workers: int,
    unit: str,
) -> Iterator[tuple[Any, Any]]:
    """Name and outcome of ``work(*arguments)`` of each task, as they end, or the exception that it
    raises, with a bar of the progress; ``tasks`` are those of ``total`` that are not yet finished.
    """
    if workers < 1:
        raise InputError(f"workers={workers}: at least one process is needed")
    if not tasks:
        return
    print(f"{total - len(tasks)} of {total} {unit}s are finished; {len(tasks)} to go. If "
          "interrupted, the same command goes on.", flush=True)
    with worker_pool(min(workers, len(tasks))) as pool, progress_bar(
            total=len(tasks), unit=unit) as bar:
        futures = {pool.submit(work, *arguments): name for name, arguments in tasks.items()}
        for future in as_completed(futures):
            error = future.exception()
            yield futures[future], error or future.result()
            bar.update()


def load_arrays(folder: Path, name: str) -> dict[str, np.ndarray]:
    """Arrays, of any shape, by name of a finished case."""
    with np.load(folder / f"{name}.npz", allow_pickle=False) as file:
        return dict(file)


def progress_bar(items: Any = None, **options: Any) -> tqdm:
    """A tqdm bar with an update interval of 0.1 s on a terminal and 10 s in a log file."""
    return tqdm(items, mininterval=0.1 if sys.stderr.isatty() else 10.0, **options)


def _stored(file: Path, key: str) -> dict[str, Any] | None:
    """Content of a result file; None if it is missing, damaged or of another key."""
    try:
        content = json.loads(file.read_text(encoding="utf-8"))
        return content if content["key"] == key and "result" in content else None
    except (OSError, ValueError, KeyError, TypeError):
        return None


def _run(
    work: Callable[..., Any], settings: Mapping[str, Any], file: Path, key: str
) -> dict[str, Any]:
    """Compute a case and write its file."""
    remove_file(file)
    result = work(**settings)
    if arrays := result.pop("arrays", None) if isinstance(result, dict) else None:
        # First, so that a result always has its arrays.
        with replacing(file.with_suffix(".npz")) as stream:
            np.savez_compressed(stream, **arrays)
    text = json.dumps({"key": key, "result": result}, indent=1, allow_nan=False)
    replace_file(file, f"{text}\n".encode())
    return json.loads(text)
