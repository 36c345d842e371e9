"""Atomic writing of files: a file is complete under its name or does not exist."""

import json
import math
import os
import re
import secrets
import tempfile
import unicodedata
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, BinaryIO

from common.errors import InputError, one_line

PARTIAL_SUFFIX = ".part"  # of a file while it is being written
LOCK = ".lock"  # in an output folder, while a run writes to it
_unfinished: set[Path] = set()


@contextmanager
def replacing(path: Path) -> Iterator[BinaryIO]:
    """Yield a temporary file beside ``path`` that replaces ``path`` at the end of the block.

    If the block fails, ``path`` is unchanged. Several processes, on any machines, may write
    ``path``, and the last one to finish wins.
    """
    temporary = path.with_name(f"{path.name}.{secrets.token_hex(4)}{PARTIAL_SUFFIX}")
    _unfinished.add(temporary)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with temporary.open("xb") as file:
            yield file
            # Otherwise the file under the final name could be empty after a power cut.
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, path)
    except OSError as error:
        reason = error.strerror or one_line(error)
        raise InputError(f"cannot write {path}: {reason}; choose another place") from error
    finally:
        with suppress(OSError):
            temporary.unlink()
        _unfinished.discard(temporary)


def remove_unfinished() -> None:
    """Remove temporary files of this process, which is about to end."""
    for temporary in list(_unfinished):
        with suppress(OSError):
            temporary.unlink()


def folder_named(out: str) -> Path:
    """Path of the key ``out=``; InputError if it is empty, which would be the current folder."""
    if not out:
        raise InputError("out= is empty; give the name of a folder")
    return Path(out)


def require_folder(folder: Path) -> None:
    """InputError if a folder is not writable and cannot be created; it is not created."""
    nearest = next(place for place in (folder, *folder.parents) if os.path.lexists(place))
    reason = "" if os.path.isdir(nearest) else "a file is in the way"
    try:
        with suppress(FileNotFoundError, NotADirectoryError):
            folder.lstat()  # too long a name
        # Permissions do not suffice: the file system may be read-only, or the user root.
        tempfile.TemporaryFile(dir=nearest).close()
    except OSError as error:
        reason = reason or error.strerror or one_line(error)
    if reason:
        raise InputError(f"cannot write to the folder {folder}: {reason}; choose another place")


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Make an output ``folder`` and keep other runs out of it until the end of the block.

    The lock is the system's: it ends with its process, even a killed one, and a file that such a
    process leaves does not count. A folder that is empty at the end, of a failed run, is removed.

    Raises:
        InputError: another run holds the folder, or it cannot be written to.
    """
    from filelock import FileLock, Timeout  # a quarter of a second, which few modules need

    require_folder(folder)
    made, file = not folder.exists(), folder / LOCK
    folder.mkdir(parents=True, exist_ok=True)
    lock = FileLock(file, timeout=0)
    try:
        lock.acquire()
    except Timeout:
        raise InputError(f"{folder}: another run is writing to this folder; wait for its end, or "
                         "give another out=") from None
    except OSError as error:
        raise InputError(f"cannot write {file}: {error.strerror or one_line(error)}; choose "
                         "another place") from None
    _unfinished.add(file)
    try:
        yield
    finally:
        with suppress(OSError):  # while it is held: another run must not have opened it since
            file.unlink()
        lock.release()
        _unfinished.discard(file)
        if made:
            with suppress(OSError):  # not empty
                folder.rmdir()


def require_file(path: Path) -> None:
    """InputError if the file ``path`` cannot be written."""
    if os.path.isdir(path):
        raise InputError(f"cannot write {path}: it is a folder; choose another place")
    require_folder(path.parent)


def replace_file(path: Path, data: bytes) -> None:
    """Write ``data`` to ``path`` in one step, see :func:`replacing`."""
    for attempt in range(10):
        try:
            with replacing(path) as file:
                file.write(data)
            return
        except InputError as error:
            # Another process has removed the temporary file in remove_partial.
            if attempt == 9 or not isinstance(error.__cause__, FileNotFoundError):
                raise


def replace_json(path: Path, content: object) -> None:
    """Write JSON to ``path`` in one step; numbers that are not finite become null."""
    text = json.dumps(finite(content), indent=2, allow_nan=False)
    replace_file(path, (text + "\n").encode())


def finite(content: Any) -> Any:
    """JSON's types with None for numbers that are not finite, for which JSON has no notation."""
    if isinstance(content, dict):
        return {key: finite(value) for key, value in content.items()}
    if isinstance(content, list | tuple):
        return [finite(value) for value in content]
    return None if isinstance(content, float) and not math.isfinite(content) else content


def remove_file(path: Path) -> None:
    """Remove the file ``path``, if it exists, and temporary files of interrupted writers."""
    try:
        path.unlink(missing_ok=True)
        remove_partial(path.parent, path.name)
    except OSError as error:
        raise InputError(f"cannot remove {path}, which is from an earlier run: "
                         f"{error.strerror}; remove it by hand") from None


def remove_partial(folder: Path, pattern: str) -> None:
    """Remove temporary files of interrupted writers of files that match ``pattern``; processes that
    are writing one by :func:`replace_file` repeat it.
    """
    for leftover in folder.glob(pattern + "*" + PARTIAL_SUFFIX):
        leftover.unlink(missing_ok=True)


def path_named(folder: Path, text: str) -> Path:
    """The path that a text from any system names, from ``folder`` on; as written if it is absent.

    Backslashes may stand for slashes, and letters with marks be composed or in parts (NFC, NFD).
    """
    written = folder / text
    parts = Path(text.replace("\\", "/")).parts
    with suppress(OSError, ValueError, StopIteration):  # too long a name; none like it
        if written.exists():
            return written
        place = folder
        for part in parts:
            place = place / part if part == ".." or os.path.lexists(place / part) else next(
                place / name for name in os.listdir(place) if composed(name) == composed(part))
        return place
    return written


def by_number(name: str | Path) -> tuple[list[list[str | int]], str]:
    """Key that sorts names or paths as people count: ``capture_2`` before ``capture_10``."""
    parts = [re.split(r"(\d+)", part) for part in Path(name).parts]  # text and number in turns
    return [[int(text) if k % 2 else text for k, text in enumerate(part)]
            for part in parts], str(name)


def composed(name: str) -> str:
    """A name with composed letters (NFC): file systems and archives also have them in parts."""
    return unicodedata.normalize("NFC", name)


def printable(path: str | Path) -> str:
    """The path with bytes that are not UTF-8 replaced: neither JSON nor a page may hold them."""
    return os.fsencode(path).decode(errors="replace")
