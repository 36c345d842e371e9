"""Limits of the service, as ``configs/serve.yaml`` states them."""

from dataclasses import dataclass, fields
from pathlib import Path

import joblib

from common.errors import InputError
from common.files import folder_named, require_folder
from drapenet.config import ServeConfig

_POSITIVE = ("queue", "job_seconds", "upload_seconds", "idle_seconds", "megabytes", "files",
             "megapixels", "keep_hours", "keep")


@dataclass(frozen=True)
class Settings:
    """Keys of ``configs/serve.yaml``, checked; sizes in bytes and pixels.

    Attributes:
        results: folder of all results.
        workers: processes.
        queue: estimates waiting or under way.
        job_seconds, upload_seconds, idle_seconds: s.
        bytes: of an upload, and of what it unpacks to.
        files: of an upload.
        pixels: of a picture.
        keep_seconds: that results stay; keep: how many.
    """

    host: str
    port: int
    names: tuple[str, ...]
    results: Path
    workers: int
    queue: int
    job_seconds: float
    upload_seconds: float
    idle_seconds: float
    bytes: int
    files: int
    pixels: int
    keep_seconds: float
    keep: int

    @classmethod
    def of(cls, config: ServeConfig) -> "Settings":
        """The settings of a ``config``; InputError for values out of range."""
        for key in _POSITIVE:
            if (value := getattr(config, key)) <= 0:
                raise InputError(f"{key}={value:g} must be positive")
        if not 0 <= config.port <= 65535:
            raise InputError(f"port={config.port} must lie between 0 and 65535")
        if config.workers < 0:
            raise InputError(f"workers={config.workers} must be 0, one for each core, or more")
        results = folder_named(config.results)
        require_folder(results)
        derived = {
            "names": tuple(name.strip() for name in config.names.split(",") if name.strip()),
            "results": results.resolve(),
            "workers": config.workers or joblib.cpu_count(),
            "bytes": round(config.megabytes * 1e6),
            "pixels": round(config.megapixels * 1e6),
            "keep_seconds": 3600 * config.keep_hours}
        return cls(**{field.name: derived.get(field.name, getattr(config, field.name, None))
                      for field in fields(cls)})
