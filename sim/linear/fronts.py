"""Symbolic part of a supernodal Cholesky factorisation: dense fronts, and what flows between.

Eliminating a node of the elimination tree works on a dense matrix, its front: the node's pivots
and the later unknowns they couple with, its others (Duff and Reid 1983). The pivots' columns are
the front's panel. What the elimination changes in the others' rows and columns, the update, is
added to the panels of the fronts whose pivots these are. Fronts of one depth in the tree do not
depend on each other; those of similar sizes are padded to p pivots and u others and form a group
of c fronts, to be handled as one stack of matrices.

All panels lie in one array, group after group, each (c, p + u, p) row-major; updates are
(c, u, u). Lower triangles are used. Padded pivots have a one on the diagonal, everything else
padded is zero.
"""

import math
from dataclasses import dataclass

import numpy as np
import torch

from sim.linear.nested_dissection import EliminationTree
from sim.linear.pattern import SparsePattern

Flow = tuple[torch.Tensor, torch.Tensor]
"""Entries to take from one array and where to add them in another. No target occurs twice, so
that sums have one order on every device."""


@dataclass(frozen=True)
class Group:
    """Fronts of one depth and one padded size.

    Attributes:
        count, pivots, others: c, p and u.
        first: where its panels begin.
        own, later: rows of the matrix that are its fronts' pivots (c p,) and others (c u,), n
            where padded.
        updates: from its updates to later groups' panels, in several flows.
        carried: from vectors (c u,) to those of n entries, likewise.
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
        """Its corners (B, c, p, p) and the rows below them (B, c, u, p) in the array (B, ...)."""
        shape = self.count, self.pivots + self.others, self.pivots
        part = array[:, self.first : self.first + math.prod(shape)].view(len(array), *shape)
        return part.split((self.pivots, self.others), dim=2)

    @property
    def flops(self) -> float:
        """Of its factorisation as carried out, with both triangles of updates."""
        return self.count * front_flops(float(self.pivots), float(self.others))


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
    values: Flow
    sizes: np.ndarray


def front_flops(p: np.ndarray | float, u: np.ndarray | float) -> np.ndarray | float:
    """Cholesky of the corner, triangular solve below it, update."""
    return p**3 / 3 + p**2 * u + 2 * p * u**2


def plan_fronts(
    pattern: SparsePattern, tree: EliminationTree, *, group_cost: float, device: torch.device
) -> Fronts:
    """Fronts of all matrices of a pattern.

    Args:
        group_cost: floating point operations of padding that one group less is worth: the
            overhead of a handful of calls.
        device: of the index lists.
    """
    n = pattern.size
    order = np.concatenate(tree.pivots)
    position = np.empty(n, dtype=np.int64)
    position[order] = np.arange(n)
    rows = np.repeat(np.arange(n), np.diff(pattern.indptr))
    pairs = np.sort(np.stack([position[rows], position[pattern.indices]]), axis=0)
    fronts = _find_fronts(tree, pairs)

    stacks, panels = [], 0
    for depth in reversed(range(tree.depth.max() + 1)):
        level = [fronts[node] for node in np.flatnonzero(tree.depth == depth)]
        for stack in _similar(level, group_cost):
            stacks.append(stack)
            panels = _place(stack, panels)
    owner = np.repeat(np.arange(len(fronts)), [front.own for front in fronts])
    padded = [np.arange(front.own, front.pivots) for front in fronts]
    ones = [front.panel + diagonal * (front.pivots + 1)
            for front, diagonal in zip(fronts, padded, strict=True)]
    entries = np.concatenate([front.entries for front in fronts])
    values = np.concatenate([front.address(*pairs[:, front.entries]) for front in fronts])
    return Fronts(
        groups=[_group(stack, fronts, owner, order, device) for stack in stacks],
        panel_size=panels,
        ones=_on(device, np.concatenate(ones)),
        values=(_on(device, entries), _on(device, values)),
        sizes=np.array([(front.own, len(front.later)) for front in fronts]),
    )


@dataclass
class _Front:
    """One front and where it lies.

    Attributes:
        rows: ascending positions of its rows in the order of elimination.
        own: how many of them are pivots.
        entries: of the matrix, in its panel.
        pivots, others: padded, filled in by :func:`_place`.
        panel: where it begins in the panels, likewise.
    """

    rows: np.ndarray
    own: int
    entries: np.ndarray
    pivots: int = 0
    others: int = 0
    panel: int = 0

    @property
    def later(self) -> np.ndarray:
        """Positions of its others."""
        return self.rows[self.own :]

    def address(self, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        """Where entries are in the panels; ``low`` are positions of pivots, ``high`` of rows."""
        row, column = np.searchsorted(self.rows, high), np.searchsorted(self.rows, low)
        row += np.where(row < self.own, 0, self.pivots - self.own)
        return self.panel + row * self.pivots + column


def _find_fronts(tree: EliminationTree, pairs: np.ndarray) -> list[_Front]:
    """The front of each node; ``pairs`` (2, nnz) positions of the entries, the smaller first."""
    by_row = np.argsort(pairs[0], kind="stable")
    ends = np.cumsum([len(pivots) for pivots in tree.pivots])
    bounds = np.searchsorted(pairs[0, by_row], np.append(0, ends))
    fronts: list[_Front] = []
    beyond: list[list[np.ndarray]] = [[] for _ in tree.pivots]
    for node, (pivots, end) in enumerate(zip(tree.pivots, ends, strict=True)):
        entries = by_row[bounds[node] : bounds[node + 1]]
        reached = np.unique(np.concatenate([pairs[1, entries], *beyond[node]]))
        own = np.arange(end - len(pivots), end)
        front = _Front(np.append(own, reached[reached >= end]), len(own), entries)
        fronts.append(front)
        beyond[tree.parent[node]].append(front.later)  # the root, whose parent is -1, has none
    return fronts


def _similar(fronts: list[_Front], group_cost: float) -> list[list[_Front]]:
    """Split fronts of one depth into groups, as long as that saves more than it costs."""
    sizes = np.array([(front.own, len(front.later)) for front in fronts], dtype=np.float64)
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


def _place(stack: list[_Front], first: int) -> int:
    """Pad the fronts of a group to one size and place their panels; where the next may begin."""
    pivots = max(front.own for front in stack)
    others = max(len(front.later) for front in stack)
    for number, front in enumerate(stack):
        front.pivots, front.others = pivots, others
        front.panel = first + number * (pivots + others) * pivots
    return first + len(stack) * (pivots + others) * pivots


def _group(
    stack: list[_Front],
    fronts: list[_Front],
    owner: np.ndarray,
    order: np.ndarray,
    device: torch.device,
) -> Group:
    """One group; all fronts have their places.

    Args:
        fronts: of all nodes.
        owner: (n,) node of each position.
        order: (n,) row of each position.
    """
    p, u = stack[0].pivots, stack[0].others
    own, later = (np.full((len(stack), size), len(order)) for size in (p, u))
    updates, carried = [], []
    for k, front in enumerate(stack):
        others = front.later
        own[k, : front.own] = order[front.rows[: front.own]]
        later[k, : len(others)] = order[others]
        carried.append(np.stack([k * u + np.arange(len(others)), order[others]]))
        i, j = np.tril_indices(len(others))
        put = np.empty_like(i)
        for node in np.unique(owner[others]):
            there = owner[others[j]] == node
            put[there] = fronts[node].address(others[j[there]], others[i[there]])
        updates.append(np.stack([(k * u + i) * u + j, put]))
    return Group(
        count=len(stack),
        pivots=p,
        others=u,
        first=stack[0].panel,
        own=_on(device, own.ravel()),
        later=_on(device, later.ravel()),
        updates=_flows(np.concatenate(updates, axis=1), device),
        carried=_flows(np.concatenate(carried, axis=1), device),
    )


def _flows(both: np.ndarray, device: torch.device) -> list[Flow]:
    """Entries to take and where to add them (2, M), so that none has a target twice."""
    order = np.argsort(both[1], kind="stable")
    target = both[1, order]
    place = np.arange(len(order))
    is_first = np.append(True, target[1:] != target[:-1])[: len(order)]
    rank = np.empty_like(order)
    rank[order] = place - np.maximum.accumulate(np.where(is_first, place, 0))
    return [tuple(_on(device, part) for part in both[:, rank == k])
            for k in range(rank.max(initial=-1) + 1)]


def _on(device: torch.device, array: np.ndarray) -> torch.Tensor:
    return torch.from_numpy(np.ascontiguousarray(array)).to(device)
