"""Symbolic part of a multifrontal Cholesky factorisation: dense fronts, and what flows between.

Eliminating a node of the elimination tree works on a dense matrix, its front: the node's pivots
and the later unknowns they couple with. What is left of the front after the elimination, the
update, is added to the parent's front (Duff and Reid 1983; Liu 1992). Fronts of one height in
the tree do not depend on each other; those of similar sizes are padded to one size and form a
group, to be handled as one stack of matrices. The layout is that of :mod:`sim.linear.front_layout`.
"""

from dataclasses import dataclass

import numpy as np

from sim.linear.front_layout import FrontLayout, Level, front_flops
from sim.linear.nested_dissection import EliminationTree


@dataclass(frozen=True)
class Fronts:
    """All fronts of a matrix, bottom up.

    Attributes:
        size: rows of the matrix.
        levels: by height.
        flops: of a factorisation without padding, one triangle of each update.
        factor_entries: of the Cholesky factor without padding.
        largest: rows of the largest front.
        distinct_sizes: different (pivots, others) before padding.
    """

    size: int
    levels: tuple[Level, ...]
    flops: float
    factor_entries: int
    largest: int
    distinct_sizes: int


def plan_fronts(
    tree: EliminationTree,
    indptr: np.ndarray,
    indices: np.ndarray,
    *,
    group_cost: float,
    entry_cost: float,
) -> Fronts:
    """Fronts of all matrices with the upper triangle ``indptr``, ``indices`` (CSR).

    Args:
        group_cost: floating point operations that one more group may cost in padding: the
            overhead of a handful of calls.
        entry_cost: floating point operations that handing on one entry of an update costs. Nodes
            are merged into their parents where that pays.
    """
    n = len(indptr) - 1
    entries, starts, counts, others = _structure(tree, indptr, indices)
    tree = _merged(tree, counts, np.array([len(u) for u in others]), entry_cost)
    entries, starts, counts, others = _structure(tree, indptr, indices)
    sizes = np.array([[p, len(u)] for p, u in zip(counts, others, strict=True)])
    unknown = np.concatenate([*tree.pivots, [n]])  # of each position; the last is padding
    levels = FrontLayout(tree, starts, counts, others, sizes, group_cost).levels(entries, unknown)
    p, u = sizes.T.astype(np.float64)
    return Fronts(
        size=n,
        levels=levels,
        flops=float((p**3 / 3 + p**2 * u + p * u**2).sum()),
        factor_entries=int((p * (p + 1) / 2 + p * u).sum()),
        largest=int(sizes.sum(axis=1).max()),
        distinct_sizes=len(np.unique(sizes, axis=0)),
    )


def _structure(
    tree: EliminationTree, indptr: np.ndarray, indices: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[np.ndarray]]:
    """The matrix's entries and the fronts in positions of the order of elimination.

    Returns:
        entries (2, nnz), smaller position first; of each node the first position and the number
        of its pivots; and the positions beyond them in its front.
    """
    n = len(indptr) - 1
    position = np.empty(n, dtype=np.int64)
    position[np.concatenate(tree.pivots)] = np.arange(n)
    entries = np.stack([position[np.repeat(np.arange(n), np.diff(indptr))], position[indices]])
    entries.sort(axis=0)
    counts = np.array([len(pivots) for pivots in tree.pivots])
    starts = np.cumsum(counts) - counts
    return entries, starts, counts, _others(tree, entries, starts, counts)


def _merged(
    tree: EliminationTree, pivots: np.ndarray, others: np.ndarray, entry_cost: float
) -> EliminationTree:
    """The tree with nodes joined to their parents where a larger front is cheaper than two."""
    def cost(p: int, u: int) -> float:
        return front_flops(p, u) + entry_cost * u * u

    count = pivots.astype(np.float64)
    parent = tree.parent.copy()
    merged = [[part] for part in tree.pivots]
    children: list[list[int]] = [[] for _ in parent]
    for node, above in enumerate(parent):
        below = children[node]
        together = count[node] + count[below].sum()
        apart = cost(count[node], others[node]) + sum(cost(count[k], others[k]) for k in below)
        if below and cost(together, others[node]) < apart:
            merged[node] = [part for k in below for part in merged[k]] + merged[node]
            count[node] = together
            for k in below:
                parent[np.asarray(children[k], dtype=np.int64)] = node
                merged[k] = []
            children[node] = [kid for k in below for kid in children[k]]
        if above >= 0:
            children[above].append(node)
    kept = np.array([bool(parts) for parts in merged])
    number = np.cumsum(kept) - 1
    return EliminationTree(
        pivots=tuple(np.concatenate(parts) for parts in merged if parts),
        parent=np.where(parent[kept] >= 0, number[parent[kept]], -1),
    )


def _others(
    tree: EliminationTree, entries: np.ndarray, starts: np.ndarray, counts: np.ndarray
) -> list[np.ndarray]:
    """For each node the sorted positions beyond its pivots that its front holds."""
    order = np.argsort(entries[0], kind="stable")
    reached = entries[1, order]
    bounds = np.searchsorted(entries[0, order], np.append(starts, starts[-1] + counts[-1]))
    others: list[np.ndarray] = []
    below: list[list[np.ndarray]] = [[] for _ in tree.parent]
    for node, parent in enumerate(tree.parent):
        found = np.unique(np.concatenate([reached[bounds[node] : bounds[node + 1]], *below[node]]))
        others.append(found[found >= starts[node] + counts[node]])
        if parent >= 0:
            below[parent].append(others[-1])
    return others
