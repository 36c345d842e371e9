"""Worker processes that make drapes: one thread each, gone when the main process is."""

import os
import pickle
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import connection, parent_process, resource_tracker
from multiprocessing.context import SpawnContext, SpawnProcess
from types import ModuleType

from common.ctrl_c import deferred
from common.errors import InputError
from common.memory import keep_freed_memory

WORKER_ENVIRONMENT = {
    "OMP_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "NUMBA_NUM_THREADS": "1",
    # Without it MKL's rounding depends on where in memory a matrix happens to lie.
    "MKL_CBWR": "AUTO",
    # Memory in large pages: 2 to 3 % less time at 41 x 41.
    "GLIBC_TUNABLES": "glibc.malloc.hugetlb=1",
}

IDLE_SECONDS = 60.0
"""For which worker processes that nobody uses stay."""


class _Worker(SpawnProcess):
    """A fresh process that Ctrl-C does not reach while it imports, before :func:`_start`."""

    def start(self) -> None:
        """Start the process, which inherits what is blocked here."""
        # Python's helper, were it started in between, would let Ctrl-C through again.
        resource_tracker.ensure_running()
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            super().start()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)


class _WorkerWithoutMain(_Worker):
    """The same without the main script, which Python would import anew, with all it imports."""

    def start(self) -> None:
        """Start the process while no script is to be found."""
        script = sys.modules["__main__"]
        sys.modules["__main__"] = ModuleType("__main__")
        try:
            super().start()
        finally:
            sys.modules["__main__"] = script


class _WorkerContext(SpawnContext):
    Process = _Worker


class _WorkerContextWithoutMain(SpawnContext):
    Process = _WorkerWithoutMain


def defined_in_main(*things: object) -> bool:
    """Whether processes that ``things`` are sent to need the main script to know them."""
    return b"__main__" in pickle.dumps(things)


@contextmanager
def worker_pool(
    workers: int, initializer: Callable[..., None] | None = None, *arguments: object
) -> Iterator[ProcessPoolExecutor]:
    """A pool of ``workers`` fresh processes; what is not done when it is left is cancelled.

    Every process imports the main script and calls ``initializer(*arguments)``; all this, and the
    work, is sent by name, so it must be importable.

    Raises:
        InputError: a worker was ended from outside.
    """
    pool = _new_pool(workers, _WorkerContext(), initializer, arguments)
    try:
        with _at_work():
            yield pool
    finally:
        with deferred():
            pool.shutdown(cancel_futures=True)


@contextmanager
def pool_for(workers: int, *things: object) -> Iterator[ProcessPoolExecutor]:
    """A pool of ``workers`` processes that can be sent ``things``, kept for who comes next.

    Processes take a second to start, as long as a drape, and some more where they import a main
    script with large libraries (:func:`defined_in_main`). Those of the last pool stay for a minute,
    unless something went wrong in it, or it needed the main script, which may change.

    Raises:
        InputError: a worker was ended from outside while it was at work.
    """
    if defined_in_main(*things):
        with worker_pool(workers) as pool:
            yield pool
        return
    pool = _kept.take(workers)
    try:
        with _at_work():
            yield pool
    except BaseException:
        with deferred():
            pool.shutdown(cancel_futures=True)
        raise
    _kept.give(workers, pool)


def _new_pool(
    workers: int,
    context: SpawnContext,
    initializer: Callable[..., None] | None = None,
    arguments: tuple = (),
) -> ProcessPoolExecutor:
    """A pool; its processes start when they are first needed, within :func:`_at_work`."""
    return ProcessPoolExecutor(
        workers, mp_context=context, initializer=_start, initargs=(initializer, arguments)
    )


@contextmanager
def _at_work() -> Iterator[None]:
    """What surrounds all work of a pool."""
    with _worker_environment():
        try:
            yield
        except BrokenProcessPool:
            raise InputError("a worker process was ended from outside, perhaps for lack of memory; "
                             "run the same command again, with fewer workers") from None


class _Kept:
    """At most one pool that is not in use."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._pool: tuple[int, ProcessPoolExecutor] | None = None
        self._end: threading.Timer | None = None

    def take(self, workers: int) -> ProcessPoolExecutor:
        """The kept pool if it has so many processes and they are alive; else a new one."""
        kept = self._exchange(None)
        if kept is not None:
            if kept[0] == workers and _is_alive(kept[1]):
                return kept[1]
            kept[1].shutdown(wait=False)
        return _new_pool(workers, _WorkerContextWithoutMain())

    def give(self, workers: int, pool: ProcessPoolExecutor) -> None:
        """Keep a pool for some time, in place of another one."""
        other = self._exchange((workers, pool))
        if other is not None:
            other[1].shutdown(wait=False)

    def _exchange(
        self, pool: tuple[int, ProcessPoolExecutor] | None
    ) -> tuple[int, ProcessPoolExecutor] | None:
        with self._lock:
            if self._end is not None:
                self._end.cancel()
                self._end = None
            before, self._pool = self._pool, pool
            if pool is not None:
                self._end = threading.Timer(IDLE_SECONDS, self._let_go, pool)
                self._end.daemon = True
                self._end.start()
        return before

    def _let_go(self, workers: int, pool: ProcessPoolExecutor) -> None:
        with self._lock:
            if self._pool is None or self._pool[1] is not pool:
                return  # it was taken at the last moment
            self._pool = self._end = None
        pool.shutdown(wait=False)


def _is_alive(pool: ProcessPoolExecutor) -> bool:
    """Whether a pool still works: its processes may have been ended meanwhile."""
    try:
        with _at_work():
            return pool.submit(os.getpid).result() > 0
    except InputError:
        return False


_kept = _Kept()
if hasattr(os, "register_at_fork"):
    # A copy of this process has no way to the processes of the original.
    os.register_at_fork(after_in_child=_kept.__init__)


def _start(initializer: Callable[..., None] | None, arguments: tuple) -> None:
    """Prepare a worker process."""
    _end_with_parent()
    keep_freed_memory()
    if initializer is not None:
        initializer(*arguments)


def _end_with_parent() -> None:
    """End this worker process when the main process is killed, and leave Ctrl-C to that one."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = parent_process()

    def follow_parent() -> None:
        connection.wait([parent.sentinel])
        os._exit(1)

    threading.Thread(target=follow_parent, daemon=True).start()


@contextmanager
def _worker_environment() -> Iterator[None]:
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
