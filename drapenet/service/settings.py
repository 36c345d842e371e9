"""Settings of the service, documented in ``configs/serve.yaml``."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import joblib
from pydantic import Field

from common.command import Threads
from drapenet.config import FromOne, Positive


@dataclass
class Settings:
    """``configs/serve.yaml``, and derived sizes in bytes and pixels and times in seconds."""

    host: str
    port: Annotated[int, Field(ge=0, le=65535)]
    names: str
    results: str
    workers: Threads
    queue: FromOne
    job_seconds: Positive
    upload_seconds: Positive
    idle_seconds: Positive
    megabytes: Positive
    files: FromOne
    megapixels: Positive
    keep_hours: Positive
    keep: FromOne

    def __post_init__(self) -> None:
        self.folder = Path(self.results).resolve()
        self.hosts = [name.strip() for name in self.names.split(",") if name.strip()]
        self.processes = self.workers or joblib.cpu_count()
        self.bytes, self.pixels = round(self.megabytes * 1e6), round(self.megapixels * 1e6)
        self.keep_seconds = 3600 * self.keep_hours
