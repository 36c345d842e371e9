"""Settings of services in tests, and workers that finish nothing."""

from collections.abc import Callable
from pathlib import Path

from pebble import ProcessFuture

from common.command import compose_config
from drapenet.config import ServeConfig


def settings_for(results: Path, *words: str) -> ServeConfig:
    """Settings of a service of one worker, with further ``words``."""
    return compose_config("serve", [f"results={results}", "workers=1", "queue=3", *words],
                          schema=ServeConfig)


class BreakablePool:
    """A pool of workers that finish no task, ``active`` until a test breaks it."""

    def __init__(self, **options: object) -> None:
        self.active, self.joined = True, False

    def schedule(self, function: Callable, **options: object) -> ProcessFuture:
        return ProcessFuture()

    def stop(self) -> None:
        """Nothing: the status of a broken pool does not change."""

    def join(self, **options: object) -> None:
        self.joined = True
