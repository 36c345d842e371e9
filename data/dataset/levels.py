"""Whole numbers at the vertices of a mesh, as differences from a prediction, which compress well.

The vertices are ordered in nested levels, each with a third more vertices than the one before and
spread over the specimen. A vertex is predicted from the nearest ones of coarser levels, by a
parabola in the rest coordinates, fitted with weights that fall off with distance. All sums are of
whole numbers, so that they do not depend on a processor's rounding.
"""

import numpy as np
from scipy.spatial import cKDTree

_GROWTH = 1.3  # vertices of a level over those of the one before
_COARSEST = 24  # vertices, at least, of the first level
_NEIGHBOURS = 10
_FALL = 3.0  # a neighbour's weight is exp(-_FALL (d/d_max)²)
_ONE = 1 << 12  # of the weights as whole numbers


class Levels:
    """Nested levels of the vertices ``rest`` (V, 2), whole numbers of any unit."""

    def __init__(self, rest: np.ndarray) -> None:
        rest = rest.astype(np.int64)
        order, sizes = _nested(rest), [len(rest)]
        while sizes[-1] > _GROWTH * _COARSEST:
            sizes.append(int(sizes[-1] / _GROWTH))
        self._order, self._sizes = order, sizes[::-1]
        self._predictions = [_prediction(rest, order[:before], order[before:size]) for before, size
                             in zip(self._sizes, self._sizes[1:], strict=False)]

    def size(self, share: float) -> int:
        """Number of vertices of the first level with this share of all, or more."""
        return next(size for size in self._sizes if size >= share * self._sizes[-1])

    def coded(self, values: np.ndarray, size: int | None = None) -> np.ndarray:
        """Differences (M, ...) of ``values`` (V, ...), whole numbers, from their predictions, in
        the order and of the type of which :meth:`decoded` makes them again; ``size``: M, that of a
        level."""
        exact = values.astype(np.int64)
        found = [exact[self._order[: self._sizes[0]]]]
        for new, near, weights in self._predictions:
            found.append(exact[new] - _predicted(exact, near, weights))
        return np.concatenate(found)[:size].astype(values.dtype)  # modulo the type's range

    def decoded(self, coded: np.ndarray) -> np.ndarray:
        """Values (V, ...) of differences (M, ...) at the vertices of the first levels; the others
        are as predicted."""
        first = self._order[: self._sizes[0]]
        exact = np.zeros((len(self._order), *coded.shape[1:]), np.int64)
        exact[first] = coded[: len(first)]
        for size, (new, near, weights) in zip(self._sizes[1:], self._predictions, strict=True):
            found = _predicted(exact, near, weights)
            if size <= len(coded):
                found += coded[size - len(new) : size]
            exact[new] = found.astype(coded.dtype)  # modulo the type's range
        return exact.astype(coded.dtype)


def _nested(rest: np.ndarray) -> np.ndarray:
    """Order (V,) of the vertices, of which each first part is spread over all: the ranks along a
    curve through the squares of a grid (Morton 1966) with their binary digits reversed."""
    if len(rest) <= _COARSEST:
        return np.arange(len(rest))
    cells = ((rest - rest.min(axis=0)) * 1023 // np.ptp(rest, axis=0).max()).astype(np.int64)
    curve = sum(((cells[:, k] >> bit) & 1) << (2 * bit + k) for bit in range(10) for k in range(2))
    rank, digits = np.arange(len(rest)), (len(rest) - 1).bit_length()
    reversed_rank = sum(((rank >> bit) & 1) << (digits - 1 - bit) for bit in range(digits))
    return np.argsort(curve, kind="stable")[np.argsort(reversed_rank, kind="stable")]


def _prediction(
    rest: np.ndarray, coarse: np.ndarray, new: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The ``new`` vertices (N,), for each the numbers (N, K) of those of ``coarse`` from which it
    is predicted, and their weights (N, K), of the sum :data:`_ONE`."""
    distance, place = cKDTree(rest[coarse]).query(rest[new], k=_NEIGHBOURS)
    reach = distance[:, -1:]
    x, y = np.moveaxis((rest[coarse][place] - rest[new][:, None]) / reach[..., None], -1, 0)
    powers = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=-1)
    weighted = powers * np.exp(-_FALL * (distance / reach) ** 2)[..., None]
    normal = np.einsum("nka,nkb->nab", powers, weighted) + 1e-6 * np.eye(6)
    weights = np.linalg.solve(normal, weighted.transpose(0, 2, 1))[:, 0]
    whole = np.rint(_ONE * weights / weights.sum(axis=1, keepdims=True)).astype(np.int64)
    whole[:, 0] += _ONE - whole.sum(axis=1)
    return new, coarse[place], whole


def _predicted(values: np.ndarray, near: np.ndarray, weights: np.ndarray) -> np.ndarray:
    return (np.einsum("nk,nk...->n...", weights, values[near]) + _ONE // 2) // _ONE
