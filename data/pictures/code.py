"""The code that covers a mat's ground: square cells in white, grey and black, no two neighbours
alike, so that no cloth of one colour looks like it over more than a cell.

Cells lie along the mat's axes from its middle on; each mat shows a part of the same code. Grey is
printed as black dots.
"""

import hashlib
from functools import cache

import numpy as np

CELL = 2.54e-3  # m, side of a cell
_CELLS = (166, 218)  # along y and x, of the largest mat
_TURNS = 60  # of drawing half of the cells anew; after some 20 no trace of the first is left
_SEED = b"drapenet mat 1"  # printed mats stay readable: never change it


@cache
def cells() -> np.ndarray:
    """Levels (H, W) uint8 of the cells, 0 white, 1 grey, 2 black, the first at the upper left; the
    middle of the mat is the corner between the four in the middle."""
    row, column = np.indices(_CELLS)
    draws = np.frombuffer(hashlib.shake_256(_SEED).digest(_TURNS * row.size), np.uint8) % 3
    code = ((row + column) % 2).astype(np.uint8)
    for turn, wish in enumerate(draws.reshape(_TURNS, *_CELLS)):
        # Half of the cells, as on a chessboard, take what their four neighbours leave free.
        near = np.pad(code, 1, constant_values=255)
        sides = np.stack([near[:-2, 1:-1], near[2:, 1:-1], near[1:-1, :-2], near[1:-1, 2:]])
        code = np.where(((row + column + turn) % 2 == 0) & (sides != wish).all(0), wish, code)
    return code


def black_dots(side: int, count: int) -> np.ndarray:
    """A grey cell as it is printed: where (side, side) pixels of it are black, ``count`` dots along
    each side."""
    along = np.arange(side) % (side // count)
    inside = (along >= 1) & (along < side // count - 1)
    return inside[:, None] & inside
