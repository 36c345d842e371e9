"""Names and units of the six targets in the stiff/soft convention.

A specimen lies on the plate in an arbitrary orientation, and a quarter turn swaps warp and weft.
So a drape alone can only tell the yarn direction with the larger linear modulus, *stiff*, from
the other, *soft*; the bias lies between them in any case.
"""

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
