"""Format of ``drape.npz``, from which another drape can start.

A NumPy archive of four arrays: ``rest`` (V, 2) and ``positions`` (V, 3) in metres, float64;
``faces`` (F, 3) int64; ``held`` (V,) bool. Axes and origin as in :class:`sim.draping.Drape`.
"""

import io
from pathlib import Path

import numpy as np

from common.documents import read_arrays
from common.errors import InputError
from common.files import replace_file
from common.types import Points, RestPoints
from sim.draping import Drape


def write_drape(path: Path, result: Drape) -> None:
    """Write ``result`` to ``path`` atomically."""
    buffer = io.BytesIO()
    np.savez_compressed(buffer, rest=result.rest, positions=result.positions, faces=result.faces,
                        held=result.held)
    replace_file(path, buffer.getvalue())


def read_borrowed(path: Path) -> tuple[RestPoints, Points]:
    """Rest points and positions of the drape in a file."""
    expected = "a drape.npz with rest and positions"
    arrays = read_arrays(path, ("rest", "positions"), expected=expected)
    rest, positions = arrays["rest"], arrays["positions"]
    for name, array, columns in (("rest", rest, 2), ("positions", positions, 3)):
        if array.dtype.kind != "f" or array.shape != (len(rest) if rest.ndim else 0, columns):
            raise InputError(f"{path}: {name} must be numbers of shape (V, {columns}); they have "
                             f"the type {array.dtype} and the shape {array.shape}")
        if not np.isfinite(array).all():
            raise InputError(f"{path}: {name} holds numbers that are not finite")
    return rest, positions
