"""Records of drapes, made by worker processes."""

from collections.abc import Iterator
from concurrent.futures import FIRST_COMPLETED, Future, wait

import numpy as np

from data.records import DatasetConfig, Renderer, Solver, make_record
from sim.workers import worker_pool

IN_FLIGHT = 4  # drapes handed out per worker, so that none waits and memory stays small

_worker: dict = {}


def _start_worker(config: DatasetConfig, solver: Solver | None, renderer: Renderer | None) -> None:
    """Prepare a worker process."""
    _worker.update(config=config, solver=solver, renderer=renderer)


def _work(index: int) -> dict[str, np.ndarray]:
    return make_record(index, **_worker)


def make_records(
    indices: list[int],
    config: DatasetConfig,
    *,
    workers: int,
    solver: Solver | None = None,
    renderer: Renderer | None = None,
) -> Iterator[dict[str, np.ndarray]]:
    """Records of the drapes ``indices``, as they are finished, from ``workers`` processes.

    ``solver`` and ``renderer`` are sent to the processes by name, so they must be importable.
    """
    if not indices:
        return
    processes = min(workers, len(indices))
    with worker_pool(processes, _start_worker, config, solver, renderer) as pool:
        waiting = iter(indices)
        running: set[Future] = set()
        while True:
            while len(running) < IN_FLIGHT * workers and (i := next(waiting, None)) is not None:
                running.add(pool.submit(_work, i))
            if not running:
                return
            done, running = wait(running, return_when=FIRST_COMPLETED)
            for future in done:
                yield future.result()
