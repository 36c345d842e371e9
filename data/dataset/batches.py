"""Drapes of a dataset made in batches on an accelerator (:mod:`sim.batched`).

A window of shards is planned at once, so that many drapes share a triangulation: they are a pool,
in which a drape that is done makes room for the next. Worker processes then make the records, whose
derivatives need factors of their own, and write the shards, while the drapes of the next window are
made. An interruption costs a window.

Drapes equal those of the CPU up to rounding, which may choose other folds.
"""

from collections.abc import Sequence
from concurrent.futures import Executor

from common.errors import InputError, one_line
from data.dataset.config import BORROWED, DatasetConfig
from data.dataset.plan import plan_drape
from data.dataset.simulate import drape_words

WINDOW = 16000
"""Drapes, at least, of a window; those of one of up to 32 triangulations of a tester take steps
together, and fewer than 100 are slower than the cores of a CPU."""


class ReadyDrapes:
    """Hands out drapes that are made, one after the other, where a solver would make them."""

    def __init__(self, drapes: Sequence) -> None:
        self._drapes = list(drapes)

    def __call__(self, **_: object) -> object:
        return self._drapes.pop(0)


def check_device(config: DatasetConfig) -> None:
    """InputError if PyTorch has no such device, or cannot make the drapes there."""
    device = config.device
    if not device:
        return
    import torch  # late: the simulator on the CPU does without

    if BORROWED in config.sampling.starts:
        raise InputError(f"device={device}: drapes that are {BORROWED} are not made in batches; "
                         f"give other starts=")
    try:
        torch.zeros(1, device=device)
    except (RuntimeError, AssertionError) as error:
        raise InputError(f"device={device}: {one_line(str(error).splitlines()[0])}") from None


def device_name(device: str) -> str:
    """The model of an accelerator, which may change the last digits of a drape."""
    import torch

    return f"{device}: {torch.cuda.get_device_name(device)}" if "cuda" in device else device


def windows(config: DatasetConfig, shards: int) -> list[range]:
    """The places of a number of ``shards`` by window; without a device, one of all."""
    size = -(-WINDOW // config.drapes_per_shard) if config.device else max(shards, 1)
    return [range(first, min(first + size, shards)) for first in range(0, shards, size)]


def ready_drapes(
    config: DatasetConfig, shards: Sequence[int], pool: Executor
) -> list[ReadyDrapes]:
    """The drapes of each of the ``shards``, made on the device of ``config``; those that are not
    finished there, in processes of the ``pool``."""
    from sim.batched.drapes import drape_batch  # late: it loads PyTorch

    rows = [config.rows(shard) for shard in shards]
    plans = [drape_words(plan_drape(index, config=config.sampling, prior=config.prior), config)
             for row in rows for index in row]
    drapes = iter(drape_batch(plans, config.device or "cpu", pool=pool))
    return [ReadyDrapes([next(drapes) for _ in row]) for row in rows]
