"""Elimination trees for sparse symmetric matrices by geometric nested dissection.

A region of the unknowns is cut in two along a line, and the fewest unknowns whose removal
separates the halves are eliminated after both of them; the halves are cut likewise. For a mesh
with n unknowns this leaves factors with O(n log n) entries (George 1973).
"""

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import breadth_first_order, maximum_bipartite_matching

from sim.linear.pattern import SparsePattern

_QUANTILES = (0.4, 0.45, 0.5, 0.55, 0.6)  # where cuts are tried, as shares of a region


@dataclass(frozen=True)
class EliminationTree:
    """Which unknowns are eliminated together, and after which others.

    A node may couple with its own descendants and ancestors only.

    Attributes:
        pivots: for each node, its unknowns (int64). Deeper nodes come first, the root last.
        parent: (N,) index of each node's parent, -1 for the root.
        depth: (N,) steps from the root; nodes of one depth do not depend on each other.
    """

    pivots: tuple[np.ndarray, ...]
    parent: np.ndarray
    depth: np.ndarray


def dissect(pattern: SparsePattern, places: np.ndarray, *, leaf: int) -> EliminationTree:
    """Nested dissection of the graph of symmetric matrices whose unknowns have places.

    Args:
        places: (n, 2) of the unknowns, in any unit.
        leaf: mean number of unknowns in the regions that are not cut any more. All leaves have
            the same depth, so that nodes of one depth are of similar sizes.
    """
    n = pattern.size
    pairs = np.stack([np.repeat(np.arange(n), np.diff(pattern.indptr)), pattern.indices])
    regions = [(np.arange(n), pairs[:, pairs[0] != pairs[1]], -1)]
    nodes: list[tuple[np.ndarray, int, int]] = []
    last = max(0, round(np.log2(n / leaf)))
    for depth in range(last + 1):
        below = []
        for region, inner, parent in regions:
            separator, parts = (region, []) if depth == last else _cut(region, inner, places)
            below += [(*part, len(nodes)) for part in parts]
            nodes.append((separator, parent, depth))
        regions = below
    pivots, parent, depth = zip(*reversed(nodes), strict=True)
    parent = [len(nodes) - 1 - above for above in parent[:-1]]
    return EliminationTree(pivots, np.array([*parent, -1]), np.array(depth))


def _cut(
    region: np.ndarray, pairs: np.ndarray, places: np.ndarray
) -> tuple[np.ndarray, list[tuple[np.ndarray, np.ndarray]]]:
    """The separator of the best cut tried, and the parts that it leaves with the pairs in each.

    Without a cut that has unknowns on both sides, the separator is the whole region.
    """
    side = np.zeros(len(places), dtype=np.int8)
    least, separator, chosen = np.inf, region, 0
    for coordinate in places[region].T:
        limits = np.quantile(coordinate, _QUANTILES, method="nearest")
        for limit in np.unique(limits[limits > coordinate.min()]):
            side[region] = np.where(coordinate < limit, 1, 2)
            cross = pairs[:, side[pairs[0]] != side[pairs[1]]]
            low = np.where(side[cross[0]] == 1, *cross)
            cover = _cover(low, cross.sum(axis=0) - low)
            side[cover] = 0
            _, small, large = np.bincount(side[region], minlength=3)
            cost = (1 + len(cover)) * (1.0 + abs(large - small) / len(region))
            if cost < least:
                least, separator, chosen = cost, cover, side[region]
    side[region] = chosen
    parts = [(region[side[region] == part], pairs[:, (side[pairs] == part).all(axis=0)])
             for part in (1, 2)]
    return separator, [part for part in parts if len(part[0])]


def _cover(low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """The fewest unknowns that touch every pair of ``low`` (M,) and ``high`` (M,).

    A minimum vertex cover of a bipartite graph, from a maximum matching (König 1931).
    """
    lows, i = np.unique(low, return_inverse=True)
    highs, j = np.unique(high, return_inverse=True)
    between = sparse.csr_matrix((np.ones(len(i)), (i, j)), (len(lows), len(highs)))
    partner = maximum_bipartite_matching(between, perm_type="column")  # (lows,), -1 for none
    # Along alternating paths from the unmatched low nodes, every high node that is reached covers.
    taken = np.flatnonzero(partner >= 0)
    unmatched = np.flatnonzero(partner < 0)
    size = len(lows) + len(highs)
    tails = np.concatenate([i, len(lows) + partner[taken], np.full(len(unmatched), size)])
    heads = np.concatenate([len(lows) + j, taken, unmatched])
    paths = sparse.csr_matrix((np.ones(len(tails)), (tails, heads)), (size + 1, size + 1))
    reached = np.zeros(size + 1, dtype=bool)
    reached[breadth_first_order(paths, size, return_predecessors=False)] = True
    return np.concatenate([lows[~reached[: len(lows)]], highs[reached[len(lows) : size]]])
