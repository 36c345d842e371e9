"""Guarded reading of NumPy's files."""

import io
import zipfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from common.documents import require_regular
from common.errors import InputError

LARGEST_ARCHIVE = 64 << 20  # bytes, of the file and of each of its arrays


def header_of(data: bytes) -> tuple[tuple[int, ...], np.dtype]:
    """Shape and type that the header of an npy file's bytes claims.

    Raises:
        Exception: whatever numpy, tokenize and others make of damage.
    """
    version = np.lib.format.read_magic(stream := io.BytesIO(data))
    shape, _, kind = {(1, 0): np.lib.format.read_array_header_1_0,
                      (2, 0): np.lib.format.read_array_header_2_0}[version](stream)
    return shape, kind


def read_arrays(
    path: Path, names: Sequence[str], *, what: str, expected: str
) -> dict[str, np.ndarray]:
    """Those of the arrays ``names``, of any shapes, that an npz file holds.

    Raises:
        InputError: the file, called ``what``, cannot be read, or is not what is ``expected``.
    """
    require_regular(path, LARGEST_ARCHIVE, what.removeprefix("the "))
    try:
        with zipfile.ZipFile(path) as archive:
            found = {name: archive.getinfo(f"{name}.npy") for name in names
                     if f"{name}.npy" in archive.namelist()}
            if any(member.file_size > LARGEST_ARCHIVE for member in found.values()):
                raise ValueError
            # A header may claim any size: memory that is never written to is never taken.
            return {name: np.lib.format.read_array(archive.open(member))
                    for name, member in found.items()}
    except Exception as error:  # what zipfile and zlib make of damaged files
        reason = getattr(error, "strerror", None) or f"not {expected}"
        raise InputError(f"cannot read {what} {path}: {reason}") from None
