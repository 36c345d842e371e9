"""Worker processes that are this process: a start takes no time."""

from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future
from contextlib import contextmanager
from typing import Any

from common import workers as real


class Here(Executor):
    """Does the work at once."""

    def submit(self, work: Callable, /, *arguments: Any, **options: Any) -> Future:
        """The work, done."""
        future: Future = Future()
        try:
            future.set_result(work(*arguments, **options))
        except Exception as error:
            future.set_exception(error)
        return future


@contextmanager
def here(workers: int) -> Iterator[Executor]:
    """In place of :func:`common.workers.worker_pool`; several workers are processes."""
    if workers == 1:
        yield Here()
    else:
        with real.worker_pool(workers) as pool:
            yield pool
