"""Writing files so that each is either complete under its name or not there."""

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from sim.errors import InputError, one_line

PARTIAL_SUFFIX = ".part"
"""Ends the name of a file while it is being written."""


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield a temporary name beside ``path``; what is written there replaces ``path`` at the end.

    The folder is created where it is missing. If the block fails, ``path`` is as it was before
    and the temporary file is removed.

    Raises:
        InputError: the system refuses to write.
    """
    temporary = path.with_name(path.name + PARTIAL_SUFFIX)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield temporary
        # Without it a power cut could leave an empty file under the final name.
        with temporary.open("rb+") as file:
            os.fsync(file.fileno())
        os.replace(temporary, path)
    except OSError as error:
        reason = error.strerror or one_line(error)
        raise InputError(f"cannot write {path}: {reason}; choose another place") from None
    finally:
        with suppress(OSError):
            temporary.unlink()


def replace_file(path: Path, data: bytes) -> None:
    """Write ``data`` to ``path`` in one step, see :func:`replacing`."""
    with replacing(path) as temporary:
        temporary.write_bytes(data)
