"""Single-threaded worker processes that end when the main process ends."""

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
"""Time after which unused worker processes end."""
_POLL_INTERVAL = 0.5  # s, at which workers check that the main process exists


class _Process(LokyProcess):
    """A worker process that inherits a blocked SIGINT and so ignores Ctrl-C."""

    def start(self) -> None:
        """Start the process."""
        # Python's resource tracker would unblock SIGINT if it was started below.
        resource_tracker.ensure_running()
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            super().start()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)


class _Context(LokyContext):
    Process = _Process


_context = _Context()
_idle_pools: dict[tuple[int, int], ProcessPoolExecutor] = {}
"""The pool that was used last, unless it is in use, by process id of the owner and size."""


@contextmanager
def worker_pool(workers: int) -> Iterator[Executor]:
    """A pool of ``workers`` processes; they are killed if the block fails or is interrupted.

    Processes take a second to start, as long as a drape, so they are kept for a minute for the next
    call of the same size. Functions of the main script are sent as code, others by name.

    Raises:
        InputError: a worker was killed from outside.
    """
    key = os.getpid(), workers  # a forked process cannot use its parent's pool
    # Loky's reusable pool is shared with joblib, which then fails.
    pool = _idle_pools.pop(key, None)
    if pool is None or pool._flags.shutdown:  # or broken
        pool = ProcessPoolExecutor(workers, context=_context, timeout=IDLE_SECONDS, env=ONE_THREAD,
                                   initializer=_start, initargs=(os.getpid(),))
    try:
        yield pool
    except BaseException as error:
        with deferred():
            # Otherwise Loky's management thread looks up the cancelled calls and fails.
            pool._work_ids.queue.clear()
            pool.shutdown(kill_workers=True)
        if isinstance(error, process_executor.TerminatedWorkerError):
            raise InputError("a worker process was killed, perhaps because memory ran out; "
                             "run the same command again with a smaller workers=") from None
        raise
    _idle_pools.clear()  # the processes of an unreferenced pool end
    _idle_pools[key] = pool


def follow(parent: int) -> None:
    """Prepare this process as a worker of the process ``parent``: it ends when the parent ends."""
    threading.Thread(target=_exit_after, args=(parent,), daemon=True).start()
    keep_freed_memory()


def _start(parent: int) -> None:
    follow(parent)
    # Loky takes large arrays for memory leaks and restarts the worker.
    process_executor._MAX_MEMORY_LEAK_SIZE = math.inf


def _exit_after(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(_POLL_INTERVAL)
    os._exit(1)
