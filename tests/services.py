"""Settings of services in tests, requests to them, and workers that finish nothing."""

import time
from collections.abc import Callable, Sequence
from pathlib import Path

from fastapi.testclient import TestClient
from httpx import Response
from pebble import ProcessFuture

from common.command import compose_config
from drapenet.config import ServeConfig
from drapenet.service.database import ENDED


def settings_for(results: Path, *words: str) -> ServeConfig:
    """Settings of a service of one worker, with further ``words``."""
    return compose_config("serve", [f"results={results}", "workers=1", "queue=3", *words],
                          schema=ServeConfig)


def post(client: TestClient, files: list[Path], **fields: str) -> Response:
    """The answer to a form with files."""
    parts = [("files", (file.name, file.read_bytes())) for file in files]
    return client.post("/estimates", files=parts, data=fields)


def awaited(client: TestClient, address: str, ready: Callable[[dict], bool]) -> dict:
    """What an address answers as soon as it is ready."""
    for _ in range(3000):
        found = client.get(address).json()
        if ready(found):
            return found
        time.sleep(0.1)
    raise AssertionError(found)


def ended(client: TestClient, identity: str) -> dict:
    """An estimate after its end."""
    return awaited(client, f"/estimates/{identity}", lambda found: found["state"] in ENDED)


def joint_estimate_of(client: TestClient, fabric: str) -> dict:
    """The joint estimate of a fabric after its end."""
    found = awaited(client, f"/fabrics/{fabric}", lambda found: found["estimates"][-1]["members"])
    return ended(client, found["estimates"][-1]["id"])


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


class PoolHere(BreakablePool):
    """A pool whose worker is this process: a task is done at its start."""

    def schedule(self, function: Callable, *, args: Sequence = (), **options: object
                 ) -> ProcessFuture:
        future = ProcessFuture()
        try:
            future.set_result(function(*args))
        except Exception as error:
            future.set_exception(error)
        return future
