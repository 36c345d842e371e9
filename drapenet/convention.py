"""Names and order of the entries of theta (:mod:`data.fabrics.fabrics`) by direction."""

STIFF_SOFT = ("stiff", "bias", "soft")
WARP_WEFT = ("warp", "bias", "weft")
COLOURS = ("#b5403a", "#6b6b6b", "#2f6da8")  # of the three directions in pictures
LINEAR = slice(0, 3)  # the entries of theta that are log alphas
RATIO = slice(3, 6)  # the entries that are beta/alpha
FIRST, SECOND = 0, 2  # log alphas of the two yarns
SWAPPED = [2, 1, 0, 5, 4, 3]
"""Indices that exchange the two yarns in theta."""
