"""Provenance of results: release, commit, versions of packages, processor."""

import functools
import platform
import re
import subprocess
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("numpy", "scipy", "numba", "llvmlite", "mkl", "pypardiso", "ipctk", "open3d", "h5py",
            "scikit-learn", "torch")
"""Packages whose version may change the last digits of a drape, view or file."""
_GIT_TIMEOUT = 20  # s; long enough for slow file systems, finite for file systems that hang


def release() -> str:
    """Version of the installed project; "unknown" where it is not installed."""
    return _version("drapenet") or "unknown"


def code_state(root: Path = ROOT) -> dict[str, object]:
    """State of the running code: ``release``, ``commit`` and ``dirty``.

    ``commit`` is None outside a git checkout. ``dirty`` is whether files differ from the commit
    or are untracked.
    """
    return {"release": release(), **_commit(root)}


def _commit(root: Path) -> dict[str, object]:
    none = {"commit": None, "dirty": False}
    top = _git(root, "rev-parse", "--show-toplevel", "HEAD")
    if top is None:
        return none
    folder, commit = top.splitlines()
    # The package may be installed inside another project's checkout.
    if Path(folder).resolve() != root.resolve() or not re.fullmatch(r"[0-9a-f]{40,64}", commit):
        return none
    changes = _git(root, "status", "--porcelain")
    return {"commit": commit, "dirty": changes is None or bool(changes.strip())}


def _git(root: Path, *words: str) -> str | None:
    """Output of git in the checkout ``root``; None if git fails."""
    try:
        run = subprocess.run(["git", "-C", str(root), *words], capture_output=True, text=True,
                             timeout=_GIT_TIMEOUT, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return None
    return run.stdout if run.returncode == 0 else None


def package_versions(*names: str) -> dict[str, str]:
    """Versions of those packages ``names`` that are installed."""
    found = {name: _version(name) for name in names}
    return {name: text for name, text in found.items() if text is not None}


def _version(name: str) -> str | None:
    try:
        return version(name)
    except PackageNotFoundError:
        return None


def processor() -> str:
    """Name of the processor."""
    try:
        with open("/proc/cpuinfo", encoding="utf-8") as file:
            return next(line.split(":")[1].strip() for line in file if "model name" in line)
    except (OSError, StopIteration):
        return platform.processor()


@functools.cache
def environment() -> dict[str, object]:
    """Full provenance in JSON types: ``code``, ``python``, ``packages``, ``processor``.

    The state at the first call, near the time when the code was loaded: a checkout may change
    during a long run. Equal settings give equal bytes in equal environments; in others, the last
    digits may differ.
    """
    return {
        "code": code_state(),
        "python": platform.python_version(),
        "packages": package_versions(*PACKAGES),
        "processor": processor(),
    }
