"""Progress bars on standard error."""

import sys
import threading
from collections.abc import Iterable

from tqdm import tqdm

DELAY = 2.0  # s; what takes less has no bar

# One process draws. tqdm's default lock is shared with forked processes, and stays locked if one of
# them is killed while it holds it.
tqdm.set_lock(threading.RLock())


def progress_bar(items: Iterable | None = None, **options: object) -> tqdm:
    """A bar of tqdm's; a log file has no use for ten lines a second."""
    pause = 0.1 if sys.stderr.isatty() else 30.0
    return tqdm(items, mininterval=pause, maxinterval=max(pause, 10.0), **options)


def over_shards(shards: Iterable, doing: str) -> tqdm:
    """``shards``, with a bar that says what is being done to them and vanishes at the end."""
    return progress_bar(shards, desc=doing, unit="shard", leave=False, delay=DELAY)
