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


class Pool:
    """Processes, which are starting and each of which first calls ``prepare``.

    Args:
        seconds: that a task may take.
    """

    def __init__(
        self, processes: int, prepare: Callable[..., None], *arguments: object, seconds: float
    ):
        self._new = partial(_new_pool, processes, prepare, arguments)
        self._seconds = seconds
        self._starting = threading.Lock()
        self._unfinished: set[futures.Future] = set()
        self._pool = self._new()

    def begun(
        self, task: Callable, *arguments: object,
        ended: Callable[[futures.Future], None] = lambda task: None
    ) -> futures.Future:
        """Begin a task; ``ended`` is called at its end or cancellation. If a thread of the pool has
        died, which finishes no task, others take its place, and its tasks are cancelled."""
        lost: list[futures.Future] = []
        with self._starting:
            if not self._pool.active:
                self.end()
                self._pool = self._new()
                lost, self._unfinished = [*self._unfinished], set()
            future = self._pool.schedule(task, args=[*arguments], timeout=self._seconds)
            self._unfinished.add(future)
        future.add_done_callback(self._unfinished.discard)
        future.add_done_callback(ended)
        for waiting in lost:
            waiting.cancel()  # calls its ended
        return future

    def end(self) -> None:
        """End the processes."""
        self._pool.stop()
        self._pool.join(timeout=5)


class Process(Pool):
    """A process for tasks whose outcome a client waits for, with ``places`` for their clients.

    Args:
        what: the tasks in words, such as exports.
        late: what is not done in the time of ``seconds``, such as exported.
        root: folder whose path no sentence states.
    """

    def __init__(
        self, what: str, late: str, prepare: Callable[[], None], *, seconds: float, root: Path
    ):
        super().__init__(1, prepare, seconds=seconds)
        self.places = Places(what, total=16, each=4)
        self._late, self._root = late, root

    def outcome(self, task: Callable, *arguments: object) -> Any:
        """Outcome of a task; RequestError with the sentence of its InputError."""
        try:
            return self.begun(task, *arguments).result()
        except InputError as error:
            raise RequestError(422, str(error.within(self._root))) from None
        except futures.TimeoutError:
            raise RequestError(503, f"not {self._late} in {self._seconds:g} s; try again"
                               ) from None


def _new_pool(
    processes: int, prepare: Callable[..., None], arguments: tuple[object, ...]
) -> ProcessPool:
    """A pool whose processes are starting."""
    pool = ProcessPool(max_workers=processes, max_tasks=_MAX_TASKS, initializer=prepare,
                       initargs=arguments, context=multiprocessing.get_context("spawn"))
    pool.schedule(os.getpid)  # starts the processes
    return pool
