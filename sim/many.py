"""Many drapes at once."""

from collections.abc import Mapping, Sequence
from typing import Any

from common.cases import progress_bar
from common.workers import worker_pool
from sim.drape import Drape, drape


def drape_many(
    plans: Sequence[Mapping[str, Any]], *, workers: int = 1, unit: str = "drape",
) -> list[Drape]:
    """The drapes of ``plans``, arguments of :func:`sim.drape.drape` by name, in their order.

    Each has its status; a simulation that fails does not affect the others, while arguments that
    are invalid raise their InputError. ``workers`` processes of one thread give the same bytes as
    one. A script calls this below ``if __name__ == "__main__":``.
    """
    with worker_pool(max(1, min(workers, len(plans)))) as pool, progress_bar(
            total=len(plans), unit=unit) as bar:
        running = [pool.submit(drape, **plan) for plan in plans]
        for call in running:
            call.add_done_callback(lambda _: bar.update())
        return [call.result() for call in running]
