"""Many drapes at once."""

import pickle
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Future
from inspect import signature
from typing import Any, TypeVar

from common.arguments import whole_number
from common.cases import progress_bar
from common.errors import InputError, one_line
from common.workers import worker_pool
from sim.draping import Drape, drape

Outcome = TypeVar("Outcome")


def drape_many(
    plans: Iterable[Mapping[str, Any]], *, workers: int = 1, unit: str = "drape",
) -> list[Drape]:
    """The drapes of ``plans``, arguments of :func:`sim.draping.drape` by name, in their order.

    Each has its status; a simulation that fails does not affect the others, while arguments that
    are invalid raise their InputError. ``workers`` processes of one thread give the same bytes as
    one. A script calls this below ``if __name__ == "__main__":``.
    """
    try:
        plans = [signature(drape).bind(**plan).arguments for plan in plans]
    except TypeError as error:
        raise InputError("plans are a list of the arguments of drape by name, such as [{'fabric': "
                         f"fabric, 'edge': 5e-3}}]: {one_line(error)}") from None
    return many(drape, plans, workers=workers, unit=unit)


def many(
    work: Callable[..., Outcome], plans: Sequence[Mapping[str, Any]], *, workers: int = 1,
    unit: str,
) -> list[Outcome]:
    """``work(**plan)`` of each of the ``plans``, in their order; as :func:`drape_many`."""
    workers = whole_number("workers", workers, 1)
    require_sendable(plans)
    with worker_pool(max(1, min(workers, len(plans)))) as pool, progress_bar(
            total=len(plans), unit=unit) as bar:
        def counted(call: Future) -> None:
            if not call.cancelled() and not call.exception():
                bar.update()

        running = [pool.submit(work, **plan) for plan in plans]
        for call in running:
            call.add_done_callback(counted)
        return [call.result() for call in running]


def require_sendable(plans: Sequence[Mapping[str, Any]]) -> None:
    """InputError for what no worker process could load."""
    try:
        of_main = any(b"__main__" in pickle.dumps(plan) for plan in plans)
    except (pickle.PicklingError, AttributeError, TypeError) as error:
        raise InputError(f"the plans cannot be sent to worker processes ({one_line(error)}); "
                         "define laws and energies in a module, not by lambda or in a cell"
                         ) from None
    if of_main and not hasattr(sys.modules["__main__"], "__file__"):
        raise InputError("worker processes cannot load what is defined in a cell or a command; "
                         "define laws and energies in a module, and import it")
