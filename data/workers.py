"""Worker processes that make drapes: one thread each, gone when the main process is."""

import os
import signal
import threading
from collections.abc import Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import connection, get_context, parent_process

import numpy as np

from data.records import DatasetConfig, Renderer, Solver, make_record
from sim.errors import InputError

WORKER_ENVIRONMENT = {
    "OMP_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "NUMBA_NUM_THREADS": "1",
    # Without it MKL's rounding depends on where in memory a matrix happens to lie.
    "MKL_CBWR": "AUTO",
}
IN_FLIGHT = 4  # drapes handed out per worker, so that none waits and memory stays small

_worker: dict = {}


def _start_worker(config: DatasetConfig, solver: Solver | None, renderer: Renderer | None) -> None:
    """Prepare a worker process."""
    end_with_parent()
    _worker.update(config=config, solver=solver, renderer=renderer)


def end_with_parent() -> None:
    """End this worker process when the main process is killed, and leave Ctrl-C to that one."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = parent_process()

    def follow_parent() -> None:
        connection.wait([parent.sentinel])
        os._exit(1)

    threading.Thread(target=follow_parent, daemon=True).start()


def _work(index: int) -> dict[str, np.ndarray]:
    return make_record(index, **_worker)


@contextmanager
def worker_environment() -> Iterator[None]:
    """Limit the threads of processes started within; they read it before numpy is loaded."""
    before = {name: os.environ.get(name) for name in WORKER_ENVIRONMENT}
    os.environ.update(WORKER_ENVIRONMENT)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


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
    with worker_environment():
        pool = ProcessPoolExecutor(
            min(workers, len(indices)),
            mp_context=get_context("spawn"),
            initializer=_start_worker,
            initargs=(config, solver, renderer),
        )
        waiting = iter(indices)
        running: set[Future] = set()
        try:
            while True:
                while len(running) < IN_FLIGHT * workers and (i := next(waiting, None)) is not None:
                    running.add(pool.submit(_work, i))
                if not running:
                    return
                done, running = wait(running, return_when=FIRST_COMPLETED)
                for future in done:
                    yield future.result()
        except BrokenProcessPool:
            raise InputError("a worker process was ended from outside, perhaps for lack of memory; "
                             "run the same command again, with fewer workers") from None
        finally:
            pool.shutdown(cancel_futures=True)
