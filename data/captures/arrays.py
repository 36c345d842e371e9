"""Validated reading of NumPy files."""

import io
import zipfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from common.documents import require_regular
from common.errors import InputError

MAX_ARCHIVE_BYTES = 64 << 20  # bytes, of the file and of each of its arrays


def header_of(data: bytes) -> tuple[tuple[int, ...], np.dtype]:
    """Shape and type in the header of an npy file's bytes.

    Raises:
        Exception: any error of numpy, tokenize and others for a damaged header.
    """
    version = np.lib.format.read_magic(stream := io.BytesIO(data))
    shape, _, kind = {(1, 0): np.lib.format.read_array_header_1_0,
                      (2, 0): np.lib.format.read_array_header_2_0}[version](stream)
    return shape, kind


def read_arrays(
    path: Path, names: Sequence[str], *, what: str, expected: str
) -> dict[str, np.ndarray]:
    """Read those of the arrays ``names``, of any shape, that an npz file contains.

    Raises:
        InputError: the file, described as ``what``, cannot be read, or is not as ``expected``.
    """
    require_regular(path, MAX_ARCHIVE_BYTES, what.removeprefix("the "))
    try:
        with zipfile.ZipFile(path) as archive:
            found = {name: archive.getinfo(f"{name}.npy") for name in names
                     if f"{name}.npy" in archive.namelist()}
            if any(member.file_size > MAX_ARCHIVE_BYTES for member in found.values()):
                raise ValueError
            # A header may claim any size: memory is not committed before it is written to.
            return {name: np.lib.format.read_array(archive.open(member))
                    for name, member in found.items()}
    except Exception as error:  # errors of zipfile and zlib for damaged files
        reason = getattr(error, "strerror", None) or f"not {expected}"
        raise InputError(f"cannot read {what} {path}: {reason}") from None
