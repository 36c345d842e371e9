"""Drapes on disk: ``drape.npz``, from which another drape can start.

A NumPy archive of four arrays: ``rest`` (V, 2) and ``positions`` (V, 3) in metres, float64;
``faces`` (F, 3) int64; ``held`` (V,) bool. Axes and origin as in :class:`sim.drape.DrapeResult`.
"""

import io
import math
import zipfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from common.documents import require_regular
from common.errors import InputError
from common.files import replace_file
from sim.drape import DrapeResult

LARGEST_ARCHIVE = 64 << 20  # bytes, of the file and of each of its arrays


def write_drape(path: Path, result: DrapeResult) -> None:
    """Write ``result`` to ``path`` whole or not at all; InputError where that is refused."""
    buffer = io.BytesIO()
    np.savez_compressed(buffer, rest=result.rest, positions=result.positions, faces=result.faces,
                        held=result.held)
    replace_file(path, buffer.getvalue())


def read_arrays(
    path: Path, names: Sequence[str], *, what: str, expected: str
) -> dict[str, np.ndarray]:
    """Those of the arrays ``names`` that an npz file holds.

    Raises:
        InputError: the file, called ``what``, cannot be read, or is not what is ``expected``.
    """
    require_regular(path, LARGEST_ARCHIVE, what.removeprefix("the "))
    try:
        with zipfile.ZipFile(path) as archive:
            found = {name: f"{name}.npy" for name in names if f"{name}.npy" in archive.namelist()}
            if any(archive.getinfo(file).file_size > LARGEST_ARCHIVE for file in found.values()):
                raise ValueError
            return {name: _read_array(archive, file) for name, file in found.items()}
    except Exception as error:  # what zipfile, zlib, tokenize and numpy make of damaged files
        reason = getattr(error, "strerror", None) or f"not {expected}"
        raise InputError(f"cannot read {what} {path}: {reason}") from None


def _read_array(archive: zipfile.ZipFile, name: str) -> np.ndarray:
    """An array of an archive, no longer than the archive says: its own header may say anything."""
    with archive.open(name) as member:
        data = member.read(archive.getinfo(name).file_size)
    version = np.lib.format.read_magic(stream := io.BytesIO(data))
    shape, _, kind = {(1, 0): np.lib.format.read_array_header_1_0,
                      (2, 0): np.lib.format.read_array_header_2_0}[version](stream)
    if math.prod(shape) * kind.itemsize > len(data):
        raise ValueError
    return np.lib.format.read_array(io.BytesIO(data), allow_pickle=False)


def read_borrowed(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Rest points (V, 2) and positions (V, 3), m, of a drape to start another one from.

    Raises:
        InputError: the file cannot be read or is not of the form described above.
    """
    expected = "a drape.npz with rest and positions"
    arrays = read_arrays(path, ("rest", "positions"), what="the drape", expected=expected)
    if len(arrays) < 2:
        raise InputError(f"{path} is not {expected}")
    rest, positions = arrays["rest"], arrays["positions"]
    for name, array, columns in (("rest", rest, 2), ("positions", positions, 3)):
        if array.dtype.kind != "f" or array.shape != (len(rest) if rest.ndim else 0, columns):
            raise InputError(f"{path}: {name} must be numbers of shape (V, {columns})")
        if not np.isfinite(array).all():
            raise InputError(f"{path}: {name} holds numbers that are not finite")
    return rest, positions
