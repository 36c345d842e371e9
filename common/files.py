"""Writing files so that each is either complete under its name or not there."""

import json
import math
import os
import secrets
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from common.errors import InputError, one_line

PARTIAL_SUFFIX = ".part"
"""Ends the name of a file while it is being written."""


@contextmanager
def replacing(path: Path) -> Iterator[BinaryIO]:
    """Yield a new file beside ``path``; what is written there replaces ``path`` at the end.

    The folder is created where it is missing. If the block fails, ``path`` is as it was before
    and the temporary file is removed. Its name is nobody else's: several processes, on any
    machines, may write ``path``, and the last one to finish wins; see :func:`remove_partial`.

    Raises:
        InputError: the system refuses to write.
    """
    temporary = path.with_name(f"{path.name}.{secrets.token_hex(4)}{PARTIAL_SUFFIX}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with temporary.open("xb") as file:
            yield file
            # Without it a power cut could leave an empty file under the final name.
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, path)
    except OSError as error:
        reason = error.strerror or one_line(error)
        raise InputError(f"cannot write {path}: {reason}; choose another place") from error
    finally:
        with suppress(OSError):
            temporary.unlink()


def folder_named(out: str) -> Path:
    """The folder of a key ``out=``, which must have a name: an empty one would be the current."""
    if not out:
        raise InputError("out= is empty; give the name of a folder")
    return Path(out)


def require_folder(out: Path) -> None:
    """InputError where ``out`` is no folder to write in and cannot become one.

    Called before long work, not after. Nothing is made of it yet.
    """
    if reason := reason_closed(out):
        raise InputError(f"cannot write to the folder {out}: {reason}; choose another place")


def require_file(path: Path) -> None:
    """InputError where no file ``path`` can be written; like :func:`require_folder`."""
    if reason := "it is a folder" if os.path.isdir(path) else reason_closed(path.parent):
        raise InputError(f"cannot write {path}: {reason}; choose another place")


def reason_closed(folder: Path) -> str:
    """Why nothing can be written into ``folder``, there or yet to be made; empty where it can."""
    nearest = next(place for place in (folder, *folder.parents) if os.path.lexists(place))
    if not os.path.isdir(nearest):
        return "a file is in the way"
    try:
        # Permissions alone do not show: of a file system that is read only, or root's.
        tempfile.TemporaryFile(dir=nearest).close()
    except OSError as error:
        return error.strerror or one_line(error)
    return ""


def replace_file(path: Path, data: bytes) -> None:
    """Write ``data`` to ``path`` in one step, see :func:`replacing`."""
    for attempt in range(10):
        try:
            with replacing(path) as file:
                file.write(data)
            return
        except InputError as error:
            # Another process has taken the file for a leftover.
            if attempt == 9 or not isinstance(error.__cause__, FileNotFoundError):
                raise


def replace_json(path: Path, content: object) -> None:
    """Write ``content`` to ``path`` as JSON, as a whole or not at all.

    Numbers that are not finite become null: JSON has none, and few programs read Python's.
    """
    text = json.dumps(_with_finite_numbers(content), indent=2, allow_nan=False)
    replace_file(path, (text + "\n").encode())


def _with_finite_numbers(content: object) -> object:
    if isinstance(content, dict):
        return {key: _with_finite_numbers(value) for key, value in content.items()}
    if isinstance(content, list | tuple):
        return [_with_finite_numbers(value) for value in content]
    return None if isinstance(content, float) and not math.isfinite(content) else content


def remove_file(path: Path) -> None:
    """Remove the file ``path`` if it is there, and what writers of it have left behind.

    Raises:
        InputError: the system refuses.
    """
    try:
        path.unlink(missing_ok=True)
        remove_partial(path.parent, path.name)
    except OSError as error:
        raise InputError(f"cannot remove {path}, which is left from an earlier run: "
                         f"{error.strerror}; remove it by hand") from None


def remove_partial(folder: Path, pattern: str) -> None:
    """Remove what writers of files named like ``pattern`` have left behind.

    Whoever is writing one with :func:`replace_file` at this moment writes it again.
    """
    for leftover in folder.glob(pattern + "*" + PARTIAL_SUFFIX):
        leftover.unlink(missing_ok=True)
