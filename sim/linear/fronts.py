"""Symbolic part of a supernodal Cholesky factorisation: dense fronts, and what flows between.

Eliminating a node of the elimination tree works on a dense matrix, its front: the node's pivots
and the later unknowns that they couple with, its others (Duff and Reid 1983). The pivots' columns
are the front's panel; the change of the others' rows and columns, its update, is added to the
panels of the nodes that own these columns. Fronts of one depth do not depend on each other; those
of similar sizes are padded to p pivots and u others and form a group of c fronts, one stack of
matrices. All panels lie in one array, group after group, (c, p + u, p) row-major; updates are
(c, u, u). Lower triangles are used. Padded pivots have a one on the diagonal; the rest of the
padding is zero.
"""

import math
from dataclasses import dataclass

import numpy as np
import torch

from sim.linear.nested_dissection import EliminationTree
from sim.linear.pattern import SparsePattern

Flow = tuple[torch.Tensor, torch.Tensor]
"""Entries to take from one array, and where to add them in another. No target occurs twice, so
that sums have one order on every device."""


@dataclass(frozen=True)
class Group:
    """Fronts of one depth and one padded size.

    Attributes:
        count, pivots, others: c, p and u.
        first: where its panels begin.
        own, later: rows of the matrix that are pivots (c p,) and others (c u,), n for padding.
        updates: from its updates to later panels, in as many flows as a target has summands.
        carried: from vectors (c u,) to those of all rows, likewise.
    """

    count: int
    pivots: int
    others: int
    first: int
    own: torch.Tensor
    later: torch.Tensor
    updates: list[Flow]
    carried: list[Flow]

    def panels(self, array: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Its corners (B, c, p, p) and the rows below them (B, c, u, p) in an array (B, ...)."""
        shape = self.count, self.pivots + self.others, self.pivots
        part = array[:, self.first : self.first + math.prod(shape)].view(len(array), *shape)
        return part.split((self.pivots, self.others), dim=2)


@dataclass(frozen=True)
class Fronts:
    """All fronts of a matrix.

    Attributes:
        groups: in the order of elimination.
        panel_size: numbers in the panels.
        ones: (M,) entries of the panels that are padded pivots' diagonal.
        values: from the CSR data to the panels.
        sizes: (N, 2) pivots and others of each front without padding.
    """

    groups: list[Group]
    panel_size: int
    ones: torch.Tensor
    values: list[Flow]
    sizes: np.ndarray


@dataclass
class _Front:
    """One front and where it lies.

    Attributes:
        rows: ascending positions of its rows in the order of elimination.
        own: how many of them are pivots.
        entries: of the matrix, in its panel.
        pivots, first: with padding, and where its panel begins; set by :func:`plan_fronts`.
    """

    rows: np.ndarray
    own: int
    entries: np.ndarray
    pivots: int = 0
    first: int = 0

    @property
    def size(self) -> tuple[int, int]:
        """Pivots and others without padding."""
        return self.own, len(self.rows) - self.own

    def address(self, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        """Where entries are in the panels; ``low`` are positions of pivots, ``high`` of rows."""
        row, column = np.searchsorted(self.rows, high), np.searchsorted(self.rows, low)
        row += np.where(row < self.own, 0, self.pivots - self.own)
        return self.first + row * self.pivots + column


def front_flops(pivots: np.ndarray | float, others: np.ndarray | float) -> np.ndarray | float:
    """Cholesky of the corner, triangular solve below it, both triangles of the update."""
    return pivots**3 / 3 + pivots**2 * others + 2 * pivots * others**2


def plan_fronts(
    pattern: SparsePattern, tree: EliminationTree, *, group_cost: float, device: torch.device
) -> Fronts:
    """Fronts of all matrices of a pattern.

    Args:
        group_cost: floating point operations of padding that one group less is worth: the
            overhead of a handful of calls.
        device: of the index lists.
    """
    order = np.concatenate(tree.pivots)
    position = np.argsort(order)
    rows = np.repeat(np.arange(pattern.size), np.diff(pattern.indptr))
    pairs = np.sort(np.stack([position[rows], position[pattern.indices]]), axis=0)
    fronts = _find_fronts(tree, pairs)
    stacks = [
        stack
        for depth in reversed(range(tree.depth.max() + 1))
        for stack in _similar([fronts[k] for k in np.flatnonzero(tree.depth == depth)], group_cost)
    ]
    panel_size, ones = 0, []
    for stack in stacks:
        pivots, others = np.max([front.size for front in stack], axis=0)
        for front in stack:
            front.pivots, front.first = pivots, panel_size
            ones.append(panel_size + np.arange(front.own, pivots) * (pivots + 1))
            panel_size += (pivots + others) * pivots
    take = np.concatenate([front.entries for front in fronts])
    put = np.concatenate([front.address(*pairs[:, front.entries]) for front in fronts])
    return Fronts(
        groups=[_group(stack, fronts, order, device) for stack in stacks],
        panel_size=int(panel_size),
        ones=torch.from_numpy(np.concatenate(ones)).to(device),
        values=_flows(take, put, device),
        sizes=np.array([front.size for front in fronts]),
    )


def _find_fronts(tree: EliminationTree, pairs: np.ndarray) -> list[_Front]:
    """The front of each node; ``pairs`` (2, nnz) positions of the entries, the smaller first."""
    by_row = np.argsort(pairs[0], kind="stable")
    ends = np.cumsum([len(pivots) for pivots in tree.pivots])
    bounds = np.searchsorted(pairs[0, by_row], np.append(0, ends))
    fronts: list[_Front] = []
    beyond: list[list[np.ndarray]] = [[] for _ in tree.pivots]
    for node, end in enumerate(ends):
        own = len(tree.pivots[node])
        entries = by_row[bounds[node] : bounds[node + 1]]
        reached = np.unique(np.concatenate([pairs[1, entries], *beyond[node]]))
        later = reached[reached >= end]
        fronts.append(_Front(np.append(np.arange(end - own, end), later), own, entries))
        beyond[tree.parent[node]].append(later)  # the root, whose parent is -1, has none
    return fronts


def _similar(fronts: list[_Front], group_cost: float) -> list[list[_Front]]:
    """Split fronts of one depth into groups, as long as that saves more than it costs."""
    sizes = np.array([front.size for front in fronts], dtype=np.float64)
    count = np.arange(1, len(fronts))
    least, parts = len(fronts) * front_flops(*sizes.max(axis=0)) - group_cost, None
    for axis in (0, 1):
        order = np.argsort(sizes[:, axis], kind="stable")
        small = np.maximum.accumulate(sizes[order])[:-1]
        large = np.maximum.accumulate(sizes[order[::-1]])[-2::-1]
        cost = count * front_flops(*small.T) + count[::-1] * front_flops(*large.T)
        if cost.min(initial=np.inf) < least:
            least, at = cost.min(), cost.argmin() + 1
            parts = order[:at], order[at:]
    if parts is None:
        return [fronts]
    return [group for part in parts for group in _similar([fronts[k] for k in part], group_cost)]


def _group(
    stack: list[_Front], fronts: list[_Front], order: np.ndarray, device: torch.device
) -> Group:
    """One group; ``fronts`` are all, in their places, and ``order`` (n,) the positions' rows."""
    owner = np.repeat(np.arange(len(fronts)), [front.own for front in fronts])
    p, u = (int(size) for size in np.max([front.size for front in stack], axis=0))
    own, later = (np.full((len(stack), size), len(order)) for size in (p, u))
    take, put = [], []
    for k, front in enumerate(stack):
        pivots, others = np.split(front.rows, [front.own])
        own[k, : len(pivots)], later[k, : len(others)] = order[pivots], order[others]
        i, j = np.tril_indices(len(others))
        target = np.empty_like(i)
        for node in np.unique(owner[others]):
            there = owner[others[j]] == node
            target[there] = fronts[node].address(others[j[there]], others[i[there]])
        take.append((k * u + i) * u + j)
        put.append(target)
    real = np.flatnonzero(later < len(order))
    return Group(
        count=len(stack),
        pivots=p,
        others=u,
        first=int(stack[0].first),
        own=torch.from_numpy(own.ravel()).to(device),
        later=torch.from_numpy(later.ravel()).to(device),
        updates=_flows(np.concatenate(take), np.concatenate(put), device),
        carried=_flows(real, later.ravel()[real], device),
    )


def _flows(take: np.ndarray, put: np.ndarray, device: torch.device) -> list[Flow]:
    """As many flows as needed for none to have a target twice."""
    order = np.argsort(put, kind="stable")
    place = np.arange(len(put))
    is_first = np.diff(put[order], prepend=-1) > 0
    rank = np.empty_like(order)
    rank[order] = place - np.maximum.accumulate(np.where(is_first, place, 0))
    return [tuple(torch.from_numpy(both[rank == k]).to(device) for both in (take, put))
            for k in range(rank.max(initial=-1) + 1)]
