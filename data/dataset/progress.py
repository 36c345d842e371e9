"""Progress bars on standard error."""

from collections.abc import Iterable

from tqdm import tqdm

from common.cases import progress_bar

DELAY = 2.0  # s; shorter tasks show no bar


def over_shards(shards: Iterable, doing: str) -> tqdm:
    """Iterate over ``shards`` with a bar labelled ``doing``, which is cleared at the end."""
    return progress_bar(shards, desc=doing, unit="shard", leave=False, delay=DELAY)
