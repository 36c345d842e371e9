"""Many runs of one algorithm, each in a thread of its own, whose costly calls are made together.

Each run is written as if it were alone. Where it needs a costly number it waits; once all runs
wait, the requests of one kind are answered in one call, and these runs go on. So a run depends on
its own numbers only, and the order of the calls is the same every time.
"""

import threading
from collections.abc import Callable, Hashable, Sequence
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
    error: BaseException | None = None


class Rendezvous:
    """Where runs wait for each other.

    Args:
        count: of runs.
    """

    def __init__(self, count: int) -> None:
        self._changed = threading.Condition()
        self._running = count
        self._waiting: dict[int, _Request] = {}

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
            self._changed.wait_for(lambda: run not in self._waiting)
        if request.error is not None:
            raise request.error
        return request.result

    def serve(self) -> None:
        """Answer requests until no run is left."""
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._running == 0)
                if not self._waiting:
                    return
                first = max(self._waiting.values(), key=lambda r: (r.priority, str(r.kind)))
                runs = sorted(k for k, r in self._waiting.items() if r.kind == first.kind)
            asked = [self._waiting[run] for run in runs]
            try:
                results = first.answer([request.argument for request in asked])
            except BaseException as error:
                for request in asked:
                    request.error = error
            else:
                for request, result in zip(asked, results, strict=True):
                    request.result = result
            with self._changed:
                for run in runs:
                    del self._waiting[run]
                self._running += len(runs)
                self._changed.notify_all()

    def leave(self) -> None:
        """One run has ended."""
        with self._changed:
            self._running -= 1
            self._changed.notify_all()


def together(runs: Sequence[Callable[[Rendezvous, int], T]]) -> list[T]:
    """The results of ``runs``, each called with the rendezvous and its number.

    An error of one run is raised once all have ended.
    """
    rendezvous = Rendezvous(len(runs))
    results: list[object] = [None] * len(runs)
    errors: list[BaseException] = []

    def work(number: int) -> None:
        try:
            results[number] = runs[number](rendezvous, number)
        except BaseException as error:
            errors.append(error)
        finally:
            rendezvous.leave()

    threads = [threading.Thread(target=work, args=(k,), daemon=True) for k in range(len(runs))]
    for thread in threads:
        thread.start()
    rendezvous.serve()
    for thread in threads:
        thread.join()
    if errors:
        raise errors[0]
    return results
