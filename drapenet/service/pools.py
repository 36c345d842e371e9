"""Pools of processes, which are replaced when a thread of them has died."""

import multiprocessing
import os
import threading
from collections.abc import Callable
from concurrent import futures
from functools import partial
from pathlib import Path
from typing import Any

from pebble import ProcessPool

from common.errors import InputError
from drapenet.service.limits import Places, RequestError

_MAX_TASKS = 500  # after which a process is replaced


class Process:
    """A process for tasks whose outcome a client waits for, with ``places`` for their clients.

    Args:
        what: the tasks in words, such as exports.
        late: what is not done in the time of ``seconds``, such as exported.
        root: folder whose path no sentence states.
    """

    def __init__(
        self, what: str, late: str, prepare: Callable[[], None], *, seconds: float, root: Path
    ):
        self.places = Places(what, total=16, each=4)
        self._late, self._seconds, self._root = late, seconds, root
        self._starting = threading.Lock()
        self._new = partial(new_pool, 1, prepare)
        self.pool = self._new()

    def outcome(self, task: Callable, *arguments: object) -> Any:
        """Outcome of a task; RequestError with the sentence of its InputError."""
        try:
            with self._starting:
                self.pool = living(self.pool, self._new)
                future = self.pool.schedule(task, args=arguments, timeout=self._seconds)
            return future.result()
        except InputError as error:
            raise RequestError(422, str(error.within(self._root))) from None
        except futures.TimeoutError:
            raise RequestError(503, f"not {self._late} in {self._seconds:g} s; try again"
                               ) from None


def living(pool: ProcessPool, another: Callable[[], ProcessPool]) -> ProcessPool:
    """The pool, or ``another`` if a thread of it has died: it finishes no task."""
    if pool.active:
        return pool
    end(pool)
    return another()


def end(pool: ProcessPool) -> None:
    """End the processes of a pool."""
    pool.stop()
    pool.join(timeout=5)


def new_pool(processes: int, prepare: Callable[..., None], *arguments: object) -> ProcessPool:
    """A pool whose processes are starting, each of which calls ``prepare``."""
    pool = ProcessPool(max_workers=processes, max_tasks=_MAX_TASKS, initializer=prepare,
                       initargs=arguments, context=multiprocessing.get_context("spawn"))
    pool.schedule(os.getpid)  # starts the processes
    return pool
