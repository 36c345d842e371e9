"""Worker processes that make whole shards."""

import tempfile
import time
from collections import Counter
from collections.abc import Callable
from concurrent.futures import FIRST_COMPLETED, wait
from dataclasses import dataclass, field
from importlib import import_module

import numpy as np

from common.workers import worker_pool
from data.folder import DatasetFolder
from data.records import Solver, load_solver, make_record

REFRESH = 0.3  # s between two looks at what the workers have done


@dataclass
class Outcome:
    """What a run of the workers took.

    Attributes:
        workers: number of processes.
        wall: s, from the first to the last.
        seconds: sums over the workers: CPU time of ``solver``, of the ``start`` until the first
            shard, and the ``rest``; ``wall``, between start and end of their work.
    """

    workers: int
    wall: float = 0.0
    seconds: Counter[str] = field(default_factory=Counter)

    def __str__(self) -> str:
        """Shares of the time that the processes had: CPU time, and the time without work.

        Time in which another program had the core, or in which the process waited for the disk,
        is stated separately.
        """
        wall = self.wall * self.workers
        spent = {"solver": self.seconds["solver"], "checks and files": self.seconds["rest"],
                 "start of the processes": self.seconds["start"],
                 "idle": max(wall - self.seconds["wall"], 0.0)}
        total = max(sum(spent.values()), 1e-9)
        shares = ", ".join(f"{name} {share / total:.1%}" for name, share in spent.items())
        return (f"time of {self.workers} worker processes: {shares}; besides, they waited "
                f"{max(wall - total, 0.0):.0f} of {wall:.0f} s for a core or the disk")


@dataclass
class _Worker:
    """What a worker process knows.

    ``counts`` (shards, 2) are the drapes made of each shard, and those that failed, in memory that
    all processes share. There is no lock, which would stay closed if its holder was killed.
    ``seconds`` are those of :class:`Outcome` that are not reported yet.
    """

    folder: DatasetFolder
    counts: np.ndarray
    solver: Solver
    seconds: Counter[str]

    def solve(self, *arguments: object, **settings: object) -> object:
        """Call the solver, and count its CPU time."""
        before = time.process_time()
        try:
            return self.solver(*arguments, **settings)
        finally:
            self.seconds["solver"] += time.process_time() - before


_worker: _Worker | None = None


def _start(folder: DatasetFolder, counts: str, solver: Solver | None, began: float) -> None:
    """Prepare a worker process; ``counts`` is the file of those of :class:`_Worker`."""
    global _worker
    import_module("sim.measures")  # not while the first drape is made
    solver = solver or load_solver()
    spent = Counter(start=time.process_time(), wall=time.time() - began)
    shared = np.memmap(counts, np.int64, "r+").reshape(-1, 2)
    _worker = _Worker(folder, shared, solver, spent)


def _make(place: int, shard: int) -> Counter[str]:
    """Make a shard, unless another run has done so; return what it took."""
    worker, cpu, wall = _worker, time.process_time(), time.perf_counter()
    config = worker.folder.config
    records: list[dict] = []
    failed = 0
    if worker.folder.content(shard) is None:
        for index in config.rows(shard):
            records.append(make_record(index, config, earlier=records, solver=worker.solve))
            failed += records[-1]["status"] != b"converged"
            worker.counts[place] = len(records), failed
        worker.folder.write(shard, records)
    worker.counts[place] = len(config.rows(shard)), failed
    seconds, worker.seconds = worker.seconds, Counter()
    seconds["rest"] += time.process_time() - cpu - seconds["solver"]
    seconds["wall"] += time.perf_counter() - wall
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
    outcome = Outcome(min(workers, len(shards)))
    if not shards:
        return outcome
    began = time.time()
    try:
        with (
            tempfile.NamedTemporaryFile() as file,
            worker_pool(outcome.workers, _start, folder, file.name, solver, began) as pool,
        ):
            counts = np.memmap(file, np.int64, "w+", shape=(len(shards), 2))
            running = {pool.submit(_make, *place) for place in enumerate(shards)}
            while running:
                done, running = wait(running, timeout=REFRESH, return_when=FIRST_COMPLETED)
                report(*counts.sum(axis=0).tolist())
                for future in done:
                    outcome.seconds.update(future.result())
            outcome.wall = time.time() - began
    except BaseException:
        folder.remove_partial()  # processes were ended, perhaps while they wrote
        raise
    return outcome
