"""Where the time of the worker processes goes."""

import time
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager

SHARES = {
    "solver": "solver",
    "rest": "checks and files",
    "start": "start of the processes",
    "idle": "idle",
}
"""What the time is spent on, and how that is called."""


class Effort:
    """CPU time of one process by activity; what is not booked is called ``rest``."""

    def __init__(self) -> None:
        self._seconds: Counter[str] = Counter()
        self._cpu, self._wall = time.process_time(), time.perf_counter()

    @contextmanager
    def booked(self, activity: str) -> Iterator[None]:
        """Book the CPU time of the block."""
        before = time.process_time()
        try:
            yield
        finally:
            self._seconds[activity] += time.process_time() - before

    def total(self) -> dict[str, float]:
        """CPU seconds of each activity since this was made, and all of the time as ``wall``."""
        rest = time.process_time() - self._cpu - self._seconds.total()
        return self._seconds | {"rest": rest, "wall": time.perf_counter() - self._wall}


def describe_effort(seconds: Mapping[str, float], *, workers: int, wall: float) -> str:
    """One line about ``workers`` processes that ran for ``wall`` seconds.

    The shares are of the time that the processes had: CPU time, and the time in which a process
    had nothing to do. Time in which another program had the core, or in which the process waited
    for the disk, is stated separately.

    Args:
        seconds: sum of the totals of all processes, with ``start``, the CPU time until the first
            shard.
    """
    wall *= workers
    spent = {name: seconds.get(name, 0.0) for name in SHARES}
    spent["idle"] = max(wall - seconds.get("wall", 0.0), 0.0)
    total = max(sum(spent.values()), 1e-9)
    shares = ", ".join(f"{name} {spent[key] / total:.1%}" for key, name in SHARES.items())
    lost = max(wall - total, 0.0)
    return (f"time of {workers} worker processes: {shares}; besides, they waited {lost:.0f} of "
            f"{wall:.0f} s for a core or the disk")
