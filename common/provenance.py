"""Provenance of results: release, commit, versions of packages, processor; digests."""

import functools
import hashlib
import json
import os
import platform
import subprocess
from contextlib import suppress
from dataclasses import asdict, is_dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("numpy", "scipy", "numba", "llvmlite", "mkl", "pypardiso", "ipctk", "open3d", "h5py",
            "scikit-learn", "torch")  # which may change the last digits of a drape, view or file
_GIT_TIMEOUT = 20  # s; long enough for slow file systems, finite for file systems that hang


def release() -> str:
    """Version of the installed project; "unknown" where it is not installed."""
    return package_versions("drapenet").get("drapenet", "unknown")


def code_state(root: Path = ROOT) -> dict[str, object]:
    """Release, commit (None outside a git checkout), and whether files differ from it."""
    # The package may be installed inside another project's checkout.
    commit = _git(root, "rev-parse", "HEAD") if (root / ".git").exists() else ""
    return {"release": release(), "commit": commit.strip() or None,
            "dirty": bool(commit and _git(root, "status", "--porcelain"))}


def digest(content: object) -> str:
    """SHA-256 of JSON types, in which dataclasses and arrays stand for their values and a path for
    the content of a file, or for the names and contents of all files of a folder; hexadecimal."""
    return hashlib.sha256(json_text(content).encode()).hexdigest()


def json_text(content: object) -> str:
    """The canonical text of a JSON value; see :func:`digest`."""
    return json.dumps(content, sort_keys=True, separators=(",", ":"), ensure_ascii=False,
                      default=_plain)


def _plain(value: object) -> object:
    if isinstance(value, Path):
        files = [value] if value.is_file() else sorted(
            file for file in value.rglob("*") if file.is_file() and "__pycache__" not in file.parts)
        return [[file.relative_to(value).as_posix(), _file_digest(file)] for file in files]
    if is_dataclass(value) and not isinstance(value, type):
        return asdict(value)
    if isinstance(value, np.ndarray):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} has no digest")


def _file_digest(file: Path) -> str:
    try:
        return hashlib.sha256(file.read_bytes()).hexdigest()
    except OSError as error:  # reported by who reads the file
        return type(error).__name__


def _git(root: Path, *words: str) -> str:
    """Output of git in the checkout ``root``; empty if git fails."""
    with suppress(OSError, subprocess.SubprocessError):
        return subprocess.run(["git", "-C", str(root), *words], capture_output=True, text=True,
                              timeout=_GIT_TIMEOUT, check=True).stdout
    return ""


def package_versions(*names: str) -> dict[str, str]:
    """Versions of those packages ``names`` that are installed."""
    versions = {}
    for name in names:
        with suppress(PackageNotFoundError):
            versions[name] = version(name)
    return versions


def processor() -> str:
    """Name of the processor."""
    with suppress(OSError, StopIteration), open("/proc/cpuinfo", encoding="utf-8") as file:
        return next(line.split(":")[1].strip() for line in file if "model name" in line)
    return platform.processor()


@functools.cache
def environment() -> dict[str, object]:
    """Full provenance in JSON types, at the first call: a checkout may change during a long run."""
    return {"code": code_state(), "python": platform.python_version(),
            "packages": package_versions(*PACKAGES), "processor": processor()}


def machine() -> dict[str, Any]:
    """Processor, number of cores and versions of packages, of reports."""
    return {
        "processor": processor(),
        "cores": os.cpu_count(),
        "python": platform.python_version(),
        **package_versions("numpy", "numba", "scipy", "torch"),
    }
