"""Parallel simulation of shards, one worker process per shard."""

import tempfile
import time
from collections import Counter
from collections.abc import Callable
from concurrent.futures import FIRST_COMPLETED, wait

import numpy as np

from common.workers import worker_pool
from data.dataset.folder import DatasetFolder
from data.dataset.simulate import Solver, load_solver, make_record

POLL_INTERVAL = 0.3  # s, at which the progress of workers is reported


def _make_shard(
    folder: DatasetFolder, counts: str, solver: Solver | None, place: int, shard: int
) -> Counter[str]:
    """Make a shard, unless another run has done so; return the seconds of :func:`_time_spent`.

    ``counts`` is a file shared by all processes, (shards, 2): drapes made and failed in the shard
    at each index (``place``). There is no lock, as it would remain locked if its holder was killed.
    """
    cpu, wall, seconds = time.process_time(), time.perf_counter(), Counter(solver=0.0)
    solver = solver or load_solver()

    def timed(*arguments: object, **settings: object) -> object:
        before = time.process_time()
        try:
            return solver(*arguments, **settings)
        finally:
            seconds["solver"] += time.process_time() - before

    done = np.memmap(counts, np.int64, "r+").reshape(-1, 2)
    rows = folder.config.rows(shard)
    if folder.content(shard) is None:
        records: list[dict] = []
        for index in rows:
            records.append(make_record(index, folder.config, earlier=records, solver=timed))
            done[place] += 1, records[-1]["status"] != b"converged"
        folder.write(shard, records)
    done[place, 0] = len(rows)
    seconds["rest"] = time.process_time() - cpu - seconds["solver"]
    seconds["wall"] = time.perf_counter() - wall
    return seconds


def make_shards(
    folder: DatasetFolder,
    shards: list[int],
    *,
    workers: int,
    solver: Solver | None = None,
    report: Callable[[int, int], None] = lambda drapes, failed: None,
) -> str:
    """Make ``shards`` in ``workers`` processes; return a breakdown of the time as text.

    ``report`` is called periodically with the numbers of drapes made and failed.

    Raises:
        InputError: a shard cannot be written; a worker was killed from outside.
    """
    if not shards:
        return ""
    workers, began, seconds = min(workers, len(shards)), time.time(), Counter()
    try:
        with tempfile.NamedTemporaryFile() as file, worker_pool(workers) as pool:
            counts = np.memmap(file, np.int64, "w+", shape=(len(shards), 2))
            running = {pool.submit(_make_shard, folder, file.name, solver, place, shard)
                       for place, shard in enumerate(shards)}
            while running:
                done, running = wait(running, timeout=POLL_INTERVAL, return_when=FIRST_COMPLETED)
                report(*counts.sum(axis=0).tolist())
                for future in done:
                    seconds.update(future.result())
    except BaseException:
        folder.remove_partial()  # processes may have been killed while writing
        raise
    return _time_spent(workers, time.time() - began, seconds)


def _time_spent(workers: int, wall: float, seconds: Counter[str]) -> str:
    """Breakdown of the time of ``workers`` processes in ``wall`` seconds: CPU time and idle time.

    Time of waiting for a core or the disk is stated separately. ``seconds`` are sums over the
    workers: CPU time of ``solver`` and ``rest``; ``wall``, elapsed time of their tasks.
    """
    spent = {"solver": seconds["solver"], "checks and files": seconds["rest"],
             "start and idle": max(workers * wall - seconds["wall"], 0.0)}
    total = max(sum(spent.values()), 1e-9)
    shares = ", ".join(f"{name} {share / total:.1%}" for name, share in spent.items())
    return (f"time of {workers} worker processes: {shares}; besides, they waited "
            f"{max(workers * wall - total, 0.0):.0f} of {workers * wall:.0f} s for a core or the "
            "disk")
