"""Names and units of the six targets in the stiff/soft convention.

A specimen lies on the plate in an arbitrary orientation, and a quarter turn swaps warp and weft.
So a drape alone can only tell the yarn direction with the larger linear modulus, *stiff*, from
the other, *soft*; the bias lies between them in any case.
"""

from collections.abc import Sequence

STIFF_SOFT = ("stiff", "bias", "soft")
TARGET_NAMES = (
    *(f"log_alpha_{name}" for name in STIFF_SOFT),
    *(f"beta_over_alpha_{name}" for name in STIFF_SOFT),
)
"""alpha in N·m inside the logarithm, beta/alpha in m, both at 300 g/m²."""
TARGET_UNITS = ("log N·m",) * 3 + ("m",) * 3
LINEAR = slice(0, 3)  # the targets that are log alphas
RATIO = slice(3, 6)  # the targets that are beta/alpha
SWAPPED = [2, 1, 0, 5, 4, 3]  # theta with warp and weft exchanged


def stiff_first(alpha: Sequence[float]) -> list[int] | slice:
    """Order of theta in which the yarns of larger ``alpha`` (3 or more,) come first."""
    return SWAPPED if alpha[0] < alpha[2] else slice(None)
