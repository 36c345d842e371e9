"""Many drapes at once."""

import pickle
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from inspect import signature
from pathlib import Path
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
        running = [pool.submit(work, **plan) for plan in plans]
        for call in running:
            call.add_done_callback(lambda call: None if call.cancelled() or call.exception() else
                                   bar.update())
        return [call.result() for call in running]


def require_sendable(plans: Sequence[Mapping[str, Any]]) -> None:
    """InputError for what no worker process could load."""
    script = getattr(sys.modules["__main__"], "__file__", None)
    try:
        content = pickle.dumps([*map(dict, plans)])
    except (pickle.PicklingError, AttributeError, TypeError) as error:
        raise InputError(f"the plans cannot be sent to worker processes ({one_line(error)}); "
                         "define laws and energies in a module, not by lambda or in a cell"
                         ) from None
    if script and not Path(script).is_file():
        raise InputError(f"the script is {script}, which worker processes cannot load; save it in "
                         "a file")
    if not script and b"__main__" in content:
        raise InputError("worker processes cannot load what is defined in a cell or a command; "
                         "define laws and energies in a module, and import it")
