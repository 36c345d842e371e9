"""Limits of the service, as ``configs/serve.yaml`` states them."""

from dataclasses import dataclass
from pathlib import Path

import joblib

from common.errors import InputError
from common.files import folder_named, require_folder

_POSITIVE = ("queue", "job_seconds", "upload_seconds", "idle_seconds", "megabytes", "files",
             "megapixels", "keep_hours", "keep")


@dataclass
class Settings:
    """``configs/serve.yaml``, and what follows from it: sizes in bytes and pixels, seconds."""

    host: str
    port: int
    names: str
    results: str
    workers: int
    queue: int
    job_seconds: float
    upload_seconds: float
    idle_seconds: float
    megabytes: float
    files: int
    megapixels: float
    keep_hours: float
    keep: int

    def __post_init__(self) -> None:
        self.folder = Path(self.results).resolve()
        self.hosts = [name.strip() for name in self.names.split(",") if name.strip()]
        self.processes = self.workers or joblib.cpu_count()
        self.bytes, self.pixels = round(self.megabytes * 1e6), round(self.megapixels * 1e6)
        self.keep_seconds = 3600 * self.keep_hours

    def check(self) -> None:
        """Raise InputError for values out of range."""
        for key in _POSITIVE:
            if (value := getattr(self, key)) <= 0:
                raise InputError(f"{key}={value:g} must be positive")
        if not 0 <= self.port <= 65535:
            raise InputError(f"port={self.port} must lie between 0 and 65535")
        if self.workers < 0:
            raise InputError(f"workers={self.workers} must be 0, one for each core, or more")
        require_folder(folder_named(self.results))
