"""Elimination trees for sparse symmetric matrices by geometric nested dissection.

A region of the unknowns is cut in two along a coordinate, and the fewest unknowns whose removal
separates the halves are eliminated after both of them; the halves are cut likewise. For a mesh
with n unknowns this leaves factors with O(n log n) entries (George 1973).
"""

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import maximum_bipartite_matching

from common.errors import InputError

_QUANTILES = (0.4, 0.45, 0.5, 0.55, 0.6)  # where cuts are tried, as shares of a region
_LARGEST_SHARE = 0.7  # of a region that a cut may leave on one side


@dataclass(frozen=True)
class EliminationTree:
    """Which unknowns are eliminated together, and after which others.

    Attributes:
        pivots: for each node, its unknowns (int64). Children come before their parents.
        parent: (N,) index of the node that each node's elimination feeds, -1 for a root. A node
            may couple with its own descendants and ancestors only.
    """

    pivots: tuple[np.ndarray, ...]
    parent: np.ndarray

    @property
    def height(self) -> np.ndarray:
        """(N,) longest way down to a leaf; nodes of one height do not depend on each other."""
        height = np.zeros(len(self.parent), dtype=np.int64)
        for node, parent in enumerate(self.parent):
            if parent >= 0:
                height[parent] = max(height[parent], height[node] + 1)
        return height


def dissect(
    indptr: np.ndarray, indices: np.ndarray, coordinates: np.ndarray, *, leaf: int = 60
) -> EliminationTree:
    """Nested dissection of the graph of a symmetric matrix whose unknowns have places.

    Args:
        indptr, indices: CSR structure of the matrix or of its upper triangle.
        coordinates: (n, d) place of each unknown, in any unit. Unknowns in straight rows (the
            integer places of a grid) give straight separators of equal sizes.
        leaf: regions of at most so many unknowns are not cut any more.

    Raises:
        InputError: not one place per unknown.
    """
    n = len(indptr) - 1
    if len(coordinates) != n or not np.isfinite(coordinates).all():
        raise InputError(f"{n} unknowns need as many finite places, got {len(coordinates)}")
    half = sparse.csr_matrix((np.ones(len(indices), dtype=np.int8), indices, indptr), (n, n))
    graph = (half + half.T).tocsr()
    pivots: list[np.ndarray] = []
    parent: list[int] = []

    def visit(region: np.ndarray) -> int:
        """Append the nodes of a region, the root of its subtree last; the root's index."""
        cut = _best_cut(graph, region, coordinates) if len(region) > leaf else None
        parts = [] if cut is None else [visit(part) for part in cut[:2] if len(part)]
        pivots.append(region if cut is None else cut[2])
        parent.append(-1)
        for part in parts:
            parent[part] = len(pivots) - 1
        return len(pivots) - 1

    visit(np.arange(n))
    return EliminationTree(pivots=tuple(pivots), parent=np.array(parent))


def _best_cut(
    graph: sparse.csr_matrix, region: np.ndarray, coordinates: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """The two sides and the separator of the best cut tried; None if no cut leaves two sides."""
    inner = graph[region][:, region]
    best, least = None, np.inf
    for axis in range(coordinates.shape[1]):
        place = coordinates[region, axis]
        for limit in np.unique(np.quantile(place, _QUANTILES, method="nearest")):
            for low in (place < limit, place <= limit):
                if not low.any() or low.all():
                    continue
                separator = _separator(inner, low)
                sides = low & ~separator, ~low & ~separator
                larger = max(side.sum() for side in sides)
                cost = separator.sum() * (1.0 + larger / len(region))
                if larger <= _LARGEST_SHARE * len(region) and cost < least:
                    least = cost
                    best = region[sides[0]], region[sides[1]], region[separator]
    return best


def _separator(inner: sparse.csr_matrix, low: np.ndarray) -> np.ndarray:
    """Mask (m,) of the fewest nodes that touch every edge between ``low`` and the others.

    A minimum vertex cover of the bipartite graph of these edges, from a maximum matching
    (König 1931).
    """
    lows, highs = np.flatnonzero(low), np.flatnonzero(~low)
    between = inner[lows][:, highs]
    lows = lows[np.diff(between.indptr) > 0]
    between = inner[lows][:, highs].tocsr()
    matched = maximum_bipartite_matching(between, perm_type="column")  # (lows,) column or -1
    partner = np.full(len(highs), -1)
    partner[matched[matched >= 0]] = np.flatnonzero(matched >= 0)
    # Alternating paths from the unmatched low nodes: there every reached high node covers.
    reached_low = matched < 0
    reached_high = np.zeros(len(highs), dtype=bool)
    front = np.flatnonzero(reached_low)
    while len(front):
        columns = np.unique(between[front].indices)
        columns = columns[~reached_high[columns]]
        reached_high[columns] = True
        front = partner[columns]
        reached_low[front] = True
    cover = np.zeros(len(low), dtype=bool)
    cover[lows[~reached_low]] = True
    cover[highs[reached_high]] = True
    return cover
