"""Worker processes that make whole shards."""

import tempfile
import time
from collections import Counter
from collections.abc import Callable
from concurrent.futures import FIRST_COMPLETED, wait
from dataclasses import dataclass
from importlib import import_module

import numpy as np

from common.workers import worker_pool
from data.effort import Effort
from data.folder import DatasetFolder
from data.records import Solver, load_solver, make_record

REFRESH = 0.3  # s between two looks at what the workers have done


@dataclass(frozen=True)
class Outcome:
    """What a run of the workers took.

    Attributes:
        seconds: sums over the workers, see :meth:`data.effort.Effort.total`, and ``start``.
        workers: number of processes.
        wall: s.
    """

    seconds: Counter[str]
    workers: int
    wall: float


@dataclass
class _Worker:
    """What a worker process knows.

    ``counts`` (shards, 2) are the drapes made of each shard, and those that failed, in memory that
    all processes share. There is no lock, which would stay closed if its holder was killed.
    """

    folder: DatasetFolder
    counts: np.ndarray
    solver: Solver
    unreported: Counter[str]


_worker: _Worker | None = None


def _start(folder: DatasetFolder, counts: str, solver: Solver | None, began: float) -> None:
    """Prepare a worker process; ``counts`` is the file of those of :class:`_Worker`."""
    global _worker
    import_module("sim.measures")  # not while the first drape is made
    solver = solver or load_solver()
    spent = Counter({"start": time.process_time(), "wall": time.time() - began})
    shared = np.memmap(counts, np.int64, "r+").reshape(-1, 2)
    _worker = _Worker(folder, shared, solver, spent)


def _make(place: int, shard: int) -> Counter[str]:
    """Make a shard, unless another run has done so; return what it took."""
    worker, effort = _worker, Effort()
    config = worker.folder.config
    records: list[dict] = []
    failed = 0
    if worker.folder.content(shard) is None:
        for index in config.rows(shard):
            records.append(make_record(index, config, earlier=records, solver=worker.solver,
                                       effort=effort))
            failed += records[-1]["status"] != b"converged"
            worker.counts[place] = len(records), failed
        worker.folder.write(shard, records)
    worker.counts[place] = len(config.rows(shard)), failed
    seconds, worker.unreported = worker.unreported, Counter()
    seconds.update(effort.total())
    return seconds


def make_shards(
    folder: DatasetFolder,
    shards: list[int],
    *,
    workers: int,
    solver: Solver | None = None,
    report: Callable[[int, int], None] = lambda drapes, failed: None,
) -> Outcome:
    """Make ``shards``, each in one of ``workers`` processes.

    ``report`` is called now and then with the number of drapes made, and of those that failed.

    Raises:
        InputError: a shard cannot be written; a worker was ended from outside.
    """
    if not shards:
        return Outcome(Counter(), 0, 0.0)
    workers = min(workers, len(shards))
    seconds: Counter[str] = Counter()
    began = time.time()
    try:
        with (
            tempfile.NamedTemporaryFile() as file,
            worker_pool(workers, _start, folder, file.name, solver, began) as pool,
        ):
            counts = np.memmap(file, np.int64, "w+", shape=(len(shards), 2))
            running = {pool.submit(_make, *place) for place in enumerate(shards)}
            while running:
                done, running = wait(running, timeout=REFRESH, return_when=FIRST_COMPLETED)
                report(*counts.sum(axis=0).tolist())
                for future in done:
                    seconds.update(future.result())
            wall = time.time() - began
    except BaseException:
        folder.remove_partial()  # processes were ended, perhaps while they wrote
        raise
    return Outcome(seconds, workers, wall)
