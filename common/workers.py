"""Single-threaded worker processes that end when the main process ends."""

import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import resource_tracker
from multiprocessing.context import SpawnContext, SpawnProcess
from typing import Any

from threadpoolctl import threadpool_limits

from common.errors import InputError

ONE_THREAD = {
    "OMP_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "NUMBA_NUM_THREADS": "1",
    # Otherwise MKL's rounding depends on the memory alignment of a matrix.
    "MKL_CBWR": os.environ.get("MKL_CBWR", "AUTO"),
    # Large pages: 2 to 3 % less time at 41 x 41.
    "GLIBC_TUNABLES": os.environ.get("GLIBC_TUNABLES", "glibc.malloc.hugetlb=1"),
}
"""Environment variables of a single-threaded process, read when libraries are loaded."""

one_blas_thread = threadpool_limits.wrap(limits=1, user_api="blas")
"""Decorator: linear algebra inside the function uses one thread.

SciPy's interpolation on a triangulation solves two equations for every triangle, for each of which
OpenBLAS synchronises its threads: at 31 x 31 vertices 0.03 s instead of 0.01 s, 5 s on busy cores.
"""

UNGUARDED = 75
"""Exit status of a process that would start processes while it loads the script that started it."""
_POSIX = hasattr(signal, "pthread_sigmask")


class _Worker(SpawnProcess):
    """A process of one thread that ignores Ctrl-C from its start."""

    def start(self) -> None:
        """Start the process; it inherits the environment and the blocked signal."""
        if _POSIX:
            resource_tracker.ensure_running()  # unblocks the signal if it is started below
            mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        before = {name: os.environ.get(name) for name in ONE_THREAD}
        os.environ.update(ONE_THREAD)
        try:
            super().start()
        finally:
            if _POSIX:
                signal.pthread_sigmask(signal.SIG_SETMASK, mask)
            for name, value in before.items():
                if value is None:
                    del os.environ[name]
                else:
                    os.environ[name] = value


class _Context(SpawnContext):
    """That of a pool, which knows its processes."""

    def __init__(self) -> None:
        super().__init__()
        self.started: list[_Worker] = []

    def Process(self, *arguments: Any, **options: Any) -> _Worker:  # type: ignore[override] # noqa: N802
        """A process of the pool."""
        self.started.append(_Worker(*arguments, **options))
        return self.started[-1]


@contextmanager
def worker_pool(workers: int) -> Iterator[ProcessPoolExecutor]:
    """A pool of ``workers`` processes; they are killed if the block fails. A script calls this
    below ``if __name__ == "__main__":``.
    """
    if multiprocessing.get_start_method() not in multiprocessing.get_all_start_methods():
        multiprocessing.set_start_method("spawn", force=True)  # a job of joblib's launcher
    if getattr(multiprocessing.current_process(), "_inheriting", False):
        os._exit(UNGUARDED)  # the first process says it, once; here it would be a traceback each
    script = getattr(sys.modules["__main__"], "__file__", None)
    if script and script.startswith("<"):
        raise InputError(f"the script is {script}, which worker processes cannot load; save it in "
                         "a file")
    context = _Context()
    pool = ProcessPoolExecutor(workers, mp_context=context, initializer=end_with_parent)
    try:
        yield pool
    except BaseException as error:
        for process in context.started:
            if process.is_alive():
                process.kill()
        if isinstance(error, BrokenProcessPool):
            pool.shutdown()  # only then all exit codes are known
            if UNGUARDED in [process.exitcode for process in context.started]:
                raise InputError(
                    'the script starts processes, each of which loads the script: indent what it '
                    'does below a line  if __name__ == "__main__":') from None
            raise InputError("a worker process was killed, perhaps because memory ran out; run "
                             "the same command again with a smaller workers=") from None
        raise
    finally:
        pool.shutdown(cancel_futures=True)


def end_with_parent() -> None:
    """Let this process end when its parent does, also if that is killed."""
    threading.Thread(target=_end, daemon=True).start()


def _end() -> None:
    if parent := multiprocessing.parent_process():
        parent.join()
    os._exit(1)
