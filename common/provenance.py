"""Provenance of results: release, commit, sources, versions of packages, processor."""

import functools
import hashlib
import platform
import subprocess
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

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


@functools.cache
def sources_digest(*patterns: str, root: Path = ROOT) -> str:
    """SHA-256 of the names and bytes of the project's Python files that match ``patterns`` such as
    "sim/*.py", hexadecimal: the same in a checkout and where the project is installed."""
    files = {file.relative_to(root).as_posix(): file
             for pattern in patterns for file in root.glob(pattern)}
    digest = hashlib.sha256()
    for name in sorted(files):
        content = files[name].read_bytes()
        digest.update(f"{name} {len(content)}\n".encode() + content)
    return digest.hexdigest()


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
