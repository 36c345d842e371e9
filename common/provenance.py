"""What made a result: the project's release and commit, and the versions it computes with."""

import functools
import platform
import re
import subprocess
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("numpy", "scipy", "numba", "llvmlite", "mkl", "pypardiso", "ipctk", "open3d", "h5py",
            "scikit-learn", "torch")
"""Packages whose version may change a drape, a view or a file in its last digits."""
_PATIENCE = 20  # s for git; slow file systems are many, hung ones should not hang the work


def release() -> str:
    """Version of the installed project; "unknown" where it is not installed."""
    return _version("drapenet") or "unknown"


def code_state(root: Path = ROOT) -> dict[str, object]:
    """The code that runs: ``release``, and of a git checkout its commit.

    ``commit`` is None outside of a checkout, which then leaves only the release. ``dirty`` says
    whether files differ from the commit or are new to it.
    """
    return {"release": release(), **_commit(root)}


def _commit(root: Path) -> dict[str, object]:
    none = {"commit": None, "dirty": False}
    top = _git(root, "rev-parse", "--show-toplevel", "HEAD")
    if top is None:
        return none
    folder, commit = top.splitlines()
    # An environment installed inside another project's checkout is none of the project's.
    if Path(folder).resolve() != root.resolve() or not re.fullmatch(r"[0-9a-f]{40,64}", commit):
        return none
    changes = _git(root, "status", "--porcelain")
    return {"commit": commit, "dirty": changes is None or bool(changes.strip())}


def _git(root: Path, *words: str) -> str | None:
    """What git prints about the checkout ``root``; None where it knows none."""
    try:
        run = subprocess.run(["git", "-C", str(root), *words], capture_output=True, text=True,
                             timeout=_PATIENCE, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return None
    return run.stdout if run.returncode == 0 else None


def package_versions(*names: str) -> dict[str, str]:
    """Versions of the installed ones among the packages ``names``."""
    found = {name: _version(name) for name in names}
    return {name: text for name, text in found.items() if text is not None}


def _version(name: str) -> str | None:
    try:
        return version(name)
    except PackageNotFoundError:
        return None


def processor() -> str:
    """The processor's name."""
    try:
        with open("/proc/cpuinfo", encoding="utf-8") as file:
            return next(line.split(":")[1].strip() for line in file if "model name" in line)
    except (OSError, StopIteration):
        return platform.processor()


@functools.cache
def environment() -> dict[str, object]:
    """Everything here, in JSON's types: ``code``, ``python``, ``packages``, ``processor``.

    As it was at the first call, about when the code was loaded: a checkout may move on while a
    long run goes on with what it has. Equal settings give equal bytes in equal environments; in
    others, perhaps only nearly.
    """
    return {
        "code": code_state(),
        "python": platform.python_version(),
        "packages": package_versions(*PACKAGES),
        "processor": processor(),
    }
