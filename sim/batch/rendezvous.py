"""Many runs of one algorithm, each in a thread of its own, whose costly calls are made together.

Each run is written as if it were alone. Where it needs a costly number it waits; once all runs
wait, the requests of one kind are answered in one call, and these runs go on. So a run depends on
its own numbers only, and the order of the calls is the same every time. Only a run that is busy by
itself for long is not waited for.
"""

import threading
from collections.abc import Callable, Hashable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TypeVar

T = TypeVar("T")
Answer = Callable[[Sequence[object]], Sequence[object]]
"""Answers the requests of one kind: as many results as there are arguments."""


@dataclass(eq=False)
class _Request:
    kind: Hashable
    priority: int
    answer: Answer
    argument: object
    result: object = None


class _Stopped(BaseException):
    """Another run or an answer has failed."""


class Rendezvous:
    """Where runs wait for each other.

    Args:
        count: of runs.
    """

    def __init__(self, count: int) -> None:
        self._changed = threading.Condition()
        self._running, self._apart = count, 0
        self._waiting: dict[int, _Request] = {}
        self._stopped = False

    def ask(
        self, run: int, kind: Hashable, priority: int, answer: Answer, argument: object
    ) -> object:
        """The answer to a request of the run number ``run``; waits for the others.

        Args:
            kind: requests of one kind are answered together, by the ``answer`` of any of them.
            priority: kinds of the highest are answered first.
        """
        request = _Request(kind, priority, answer, argument)
        with self._changed:
            self._waiting[run] = request
            self._running -= 1
            self._changed.notify_all()
            self._changed.wait_for(lambda: run not in self._waiting or self._stopped)
            if run in self._waiting:
                raise _Stopped
        return request.result

    @contextmanager
    def apart(self) -> Iterator[None]:
        """The others do not wait for a run that is busy by itself for long."""
        self._count(running=-1, apart=1)
        try:
            yield
        finally:
            self._count(running=1, apart=-1)

    def serve(self) -> None:
        """Answer requests until no run is left."""
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._stopped or (
                    self._running == 0 and (self._waiting or self._apart == 0)))
                if self._stopped or not self._waiting:
                    return
                first = max(self._waiting.values(), key=lambda r: (r.priority, str(r.kind)))
                runs = sorted(k for k, r in self._waiting.items() if r.kind == first.kind)
            asked = [self._waiting[run] for run in runs]
            results = first.answer([request.argument for request in asked])
            for request, result in zip(asked, results, strict=True):
                request.result = result
            with self._changed:
                for run in runs:
                    del self._waiting[run]
                self._running += len(runs)
                self._changed.notify_all()

    def leave(self) -> None:
        """One run has ended."""
        self._count(running=-1)

    def stop(self) -> None:
        """End all runs where they wait, or when they next ask."""
        with self._changed:
            self._stopped = True
            self._changed.notify_all()

    def _count(self, *, running: int, apart: int = 0) -> None:
        with self._changed:
            self._running += running
            self._apart += apart
            self._changed.notify_all()


def together(runs: Sequence[Callable[[Rendezvous, int], T]]) -> list[T]:
    """The results of ``runs``, each called with the rendezvous and its number.

    An error of one run, or of an answer, ends all of them.
    """
    rendezvous = Rendezvous(len(runs))
    results: list[object] = [None] * len(runs)
    errors: list[BaseException] = []

    def work(number: int) -> None:
        try:
            results[number] = runs[number](rendezvous, number)
        except _Stopped:
            pass
        except BaseException as error:
            errors.append(error)
            rendezvous.stop()
        finally:
            rendezvous.leave()

    threads = [threading.Thread(target=work, args=(k,), daemon=True) for k in range(len(runs))]
    for thread in threads:
        thread.start()
    try:
        rendezvous.serve()
    finally:
        rendezvous.stop()
    if errors:
        raise errors[0]
    for thread in threads:
        thread.join()
    return results
