"""Captures equivalent to a given one: another first view, or the mirror image.

View k shows the specimen a quarter turn counter-clockwise (seen from above) after view k-1, so
the views may start anywhere in the circle. In a mirror the table turns the other way: every
view is flipped and the order reversed. Moduli do not change; the direction of an axis does.
"""

import numpy as np

ORDERS = tuple((first, mirror) for mirror in (False, True) for first in range(4))
"""All eight equivalents, as the arguments (first, mirror) of the functions below."""


def reorder_views(views: np.ndarray, *, first: int, mirror: bool) -> np.ndarray:
    """Views (4, H, W) as (4, H, W) that start at view ``first``, then mirrored if asked."""
    views = np.roll(views, -first, axis=0)
    return np.ascontiguousarray(views[[0, 3, 2, 1], :, ::-1]) if mirror else views


def reorder_axis(angle: float, *, first: int, mirror: bool) -> float:
    """Direction in [0, pi) of an axis at ``angle`` in the first view, after reordering.

    Angles are counter-clockwise seen from above, 0 to the right in the picture, in radians.
    """
    turned = angle + first * np.pi / 2
    return float(np.mod(-turned if mirror else turned, np.pi))


def restore_axis(angle: float, *, first: int, mirror: bool) -> float:
    """The inverse of :func:`reorder_axis`: back to the direction in the original first view."""
    turned = -angle if mirror else angle
    return float(np.mod(turned - first * np.pi / 2, np.pi))
