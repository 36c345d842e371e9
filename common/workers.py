"""Worker processes that make drapes: one thread each, gone when the main process is."""

import math
import os
import signal
import threading
import time
from collections.abc import Iterator
from concurrent.futures import Executor
from contextlib import contextmanager
from multiprocessing import resource_tracker

from joblib.externals.loky import ProcessPoolExecutor, process_executor
from joblib.externals.loky.backend.context import LokyContext
from joblib.externals.loky.backend.process import LokyProcess

from common.ctrl_c import deferred
from common.errors import InputError
from common.memory import keep_freed_memory
from common.threads import ONE_THREAD

IDLE_SECONDS = 60.0
"""For which worker processes that nobody uses stay."""
_LOOK = 0.5  # s between two looks at whether the main process is there


class _Process(LokyProcess):
    """A worker process that Ctrl-C never reaches: it inherits what is blocked here."""

    def start(self) -> None:
        """Start the process."""
        # Python's helper, were it started in between, would let Ctrl-C through again.
        resource_tracker.ensure_running()
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            super().start()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)


class _Context(LokyContext):
    Process = _Process


_context = _Context()
_kept: dict[tuple[int, int], ProcessPoolExecutor] = {}
"""The pool that was used last, unless it is in use, by its main process and its size."""


@contextmanager
def worker_pool(workers: int) -> Iterator[Executor]:
    """A pool of ``workers`` processes, ended at once where the block fails or is interrupted.

    Processes take a second to start, as long as a drape. So they stay for a minute, for the next
    call of as many. What the main script defines is sent as code, all else by name.

    Raises:
        InputError: a worker was ended from outside.
    """
    key = os.getpid(), workers  # a copy of this process has no way to the original's processes
    # Loky's own reusable pool is not ours alone: joblib takes it for its own, and fails.
    pool = _kept.pop(key, None)
    if pool is None or pool._flags.shutdown:  # or broken
        pool = ProcessPoolExecutor(workers, context=_context, timeout=IDLE_SECONDS, env=ONE_THREAD,
                                   initializer=_start, initargs=(os.getpid(),))
    try:
        yield pool
    except BaseException as error:
        with deferred():
            # Else Loky's own thread would look for the calls that it has given up, and fail.
            pool._work_ids.queue.clear()
            pool.shutdown(kill_workers=True)
        if isinstance(error, process_executor.TerminatedWorkerError):
            raise InputError("a worker process was killed, perhaps because memory ran out; "
                             "run the same command again with a smaller workers=") from None
        raise
    _kept.clear()  # the processes of a pool that nobody holds end
    _kept[key] = pool


def follow(parent: int) -> None:
    """Prepare this process as a worker of the process ``parent``: it ends when that one does."""
    threading.Thread(target=_end_with, args=(parent,), daemon=True).start()
    keep_freed_memory()


def _start(parent: int) -> None:
    follow(parent)
    # Loky takes large arrays for a leak, and a process that has made one for spent.
    process_executor._MAX_MEMORY_LEAK_SIZE = math.inf


def _end_with(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(_LOOK)
    os._exit(1)
