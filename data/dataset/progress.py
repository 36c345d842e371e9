"""Progress bars on standard error."""

import sys
import threading
from collections.abc import Iterable

from tqdm import tqdm

DELAY = 2.0  # s; shorter tasks show no bar

# One process draws. tqdm's default lock is shared with forked processes, and stays locked if one of
# them is killed while it holds it.
tqdm.set_lock(threading.RLock())


def progress_bar(items: Iterable | None = None, **options: object) -> tqdm:
    """A tqdm bar with an update interval of 0.1 s on a terminal and 30 s in a log file."""
    pause = 0.1 if sys.stderr.isatty() else 30.0
    return tqdm(items, mininterval=pause, maxinterval=max(pause, 10.0), **options)


def over_shards(shards: Iterable, doing: str) -> tqdm:
    """Iterate over ``shards`` with a bar labelled ``doing``, which is cleared at the end."""
    return progress_bar(shards, desc=doing, unit="shard", leave=False, delay=DELAY)
