"""Worker processes that make whole shards."""

import time
from collections import Counter
from collections.abc import Callable
from concurrent.futures import FIRST_COMPLETED, wait
from dataclasses import dataclass
from importlib import import_module
from multiprocessing import get_context

from common.workers import worker_pool
from data.effort import Effort
from data.folder import DatasetFolder
from data.records import Renderer, Solver, load_solver, make_record

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


class _Board:
    """Numbers that workers write and the main process reads, without locks.

    A lock would stay closed for ever if its holder was killed.
    """

    def __init__(self, shards: int) -> None:
        self._cells = get_context("spawn").RawArray("q", 1 + 2 * shards)

    def stop(self) -> None:
        """Ask the workers to leave their shards unfinished."""
        self._cells[0] = 1

    @property
    def stopped(self) -> bool:
        return bool(self._cells[0])

    def count(self, place: int, *, drapes: int, failed: int) -> None:
        """Tell how far the ``place``-th shard is."""
        self._cells[1 + 2 * place : 3 + 2 * place] = [drapes, failed]

    def totals(self) -> tuple[int, int]:
        """Drapes made, and how many of them failed."""
        return sum(self._cells[1::2]), sum(self._cells[2::2])


@dataclass
class _Worker:
    """What a worker process knows."""

    folder: DatasetFolder
    board: _Board
    solver: Solver
    renderer: Renderer | None
    unreported: Counter[str]


_worker: _Worker | None = None


def _start(
    folder: DatasetFolder,
    board: _Board,
    solver: Solver | None,
    renderer: Renderer | None,
    began: float,
) -> None:
    """Prepare a worker process."""
    global _worker
    import_module("sim.measures")  # not while the first drape is made
    solver = solver or load_solver()
    spent = Counter({"start": time.process_time(), "wall": time.time() - began})
    _worker = _Worker(folder, board, solver, renderer, spent)


def _make(place: int, shard: int) -> Counter[str]:
    """Make a shard, unless another run has done so; return what it took."""
    worker, effort = _worker, Effort()
    config = worker.folder.config
    records: list[dict] = []
    failed = 0
    if worker.folder.content(shard) is None:
        for index in config.rows(shard):
            if worker.board.stopped:
                break
            records.append(make_record(index, config, earlier=records, solver=worker.solver,
                                       renderer=worker.renderer, effort=effort))
            failed += records[-1]["status"] != b"converged"
            worker.board.count(place, drapes=len(records), failed=failed)
        else:
            worker.folder.write(shard, records)
    worker.board.count(place, drapes=len(config.rows(shard)), failed=failed)
    seconds, worker.unreported = worker.unreported, Counter()
    seconds.update(effort.total())
    return seconds


def make_shards(
    folder: DatasetFolder,
    shards: list[int],
    *,
    workers: int,
    solver: Solver | None = None,
    renderer: Renderer | None = None,
    report: Callable[[int, int], None] = lambda drapes, failed: None,
) -> Outcome:
    """Make ``shards``, each in one of ``workers`` processes.

    ``solver`` and ``renderer`` are sent to the processes by name, so they must be importable.
    ``report`` is called now and then with the number of drapes made, and of those that failed.

    Raises:
        InputError: a shard cannot be written; a worker was ended from outside.
    """
    if not shards:
        return Outcome(Counter(), 0, 0.0)
    workers = min(workers, len(shards))
    seconds: Counter[str] = Counter()
    board, began = _Board(len(shards)), time.time()
    with worker_pool(workers, _start, folder, board, solver, renderer, began) as pool:
        try:
            running = {pool.submit(_make, *place) for place in enumerate(shards)}
            while running:
                done, running = wait(running, timeout=REFRESH, return_when=FIRST_COMPLETED)
                report(*board.totals())
                for future in done:
                    seconds.update(future.result())
            wall = time.time() - began
        finally:
            # Else leaving the pool would wait for whole shards after an error or Ctrl-C.
            board.stop()
    return Outcome(seconds, workers, wall)
