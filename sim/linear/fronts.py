"""Symbolic part of a multifrontal Cholesky factorisation: dense fronts, and what flows between.

Eliminating a node of the elimination tree works on a dense matrix, its front: the node's pivots
and the later unknowns they couple with, its others. What is left of the front after the
elimination, the update, is added to the parent's front (Duff and Reid 1983; Liu 1992). Fronts of
one depth in the tree do not depend on each other; those of similar sizes are padded to p pivots
and u others and form a group of c fronts, to be handled as one stack of matrices.

The fronts of one depth lie in two arrays, group after group and row-major: panels (c, p + u, p),
which are the pivots' columns, and updates (c, u, u). Lower triangles are used. Padded pivots have
a one on the diagonal, everything else padded is zero. For solves, vectors (c, p + u) lie likewise.
"""

import math
from dataclasses import dataclass

import numpy as np
import torch

from sim.linear.nested_dissection import EliminationTree
from sim.linear.pattern import SparsePattern

Flow = tuple[torch.Tensor, torch.Tensor]
"""Entries to take from one array and where to add them in another; no target occurs twice, so
that sums have one order on every device."""


def front_flops(p: np.ndarray | float, u: np.ndarray | float) -> np.ndarray | float:
    """Of a front as carried out: Cholesky, triangular solve, the update's both triangles."""
    return p**3 / 3 + p**2 * u + 2 * p * u**2


@dataclass(frozen=True)
class Group:
    """Fronts of one depth and one padded size.

    Attributes:
        count, pivots, others: c, p and u.
        panel, update, vector: where it begins in the arrays of its depth.
    """

    count: int
    pivots: int
    others: int
    panel: int
    update: int
    vector: int

    @property
    def rows(self) -> int:
        """Of each front."""
        return self.pivots + self.others

    def panels(self, array: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Its corners (B, c, p, p) and the rows below them (B, c, u, p) in the depth's panels."""
        return self._both(array, self.panel, self.pivots)

    def vectors(self, array: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Its pivots (B, c, p, 1) and others (B, c, u, 1) in the depth's vectors."""
        return self._both(array, self.vector, 1)

    def updates(self, array: torch.Tensor) -> torch.Tensor:
        """Its (B, c, u, u) in the depth's updates."""
        shape = self.count, self.others, self.others
        return array[:, self.update : self.update + math.prod(shape)].view(len(array), *shape)

    def _both(self, array: torch.Tensor, first: int, width: int) -> tuple[torch.Tensor, ...]:
        shape = self.count, self.rows, width
        part = array[:, first : first + math.prod(shape)].view(len(array), *shape)
        return part.split((self.pivots, self.others), dim=2)


@dataclass(frozen=True)
class Level:
    """The fronts of one depth.

    Attributes:
        groups: by size.
        unknowns: (R,) the whole matrix's row of each entry of the vectors, n for padding.
        ones: (M,) entries of the panels that are padded pivots' diagonal.
        values: from the CSR data to the panels.
        children: what the panels, updates and vectors receive from the updates, updates and
            vectors of the next depth: of first children, of second children.
    """

    groups: list[Group]
    unknowns: torch.Tensor
    ones: torch.Tensor
    values: Flow
    children: list[tuple[Flow, Flow, Flow]]

    @property
    def panel_size(self) -> int:
        """Numbers in the panels."""
        return sum(group.count * group.rows * group.pivots for group in self.groups)

    @property
    def update_size(self) -> int:
        """Numbers in the updates."""
        return sum(group.count * group.others**2 for group in self.groups)


@dataclass(frozen=True)
class Fronts:
    """All fronts of a matrix.

    Attributes:
        levels: by depth, the root first.
        sizes: (N, 2) pivots and others of each front without padding.
    """

    levels: list[Level]
    sizes: np.ndarray


@dataclass
class _Front:
    """One front and where it lies.

    Attributes:
        rows: ascending positions of its rows in the order of elimination.
        own: how many of them are pivots.
        entries: of the matrix, that belong to it.
        children: the fronts whose updates it receives.
        group, place: filled in by :func:`_grouped`.
    """

    rows: np.ndarray
    own: int
    entries: np.ndarray
    children: list["_Front"]
    group: Group | None = None
    place: int = 0

    def local(self, positions: np.ndarray) -> np.ndarray:
        """Padded rows of positions that the front has."""
        row = np.searchsorted(self.rows, positions)
        return np.where(row < self.own, row, row + self.group.pivots - self.own)

    def vector(self, rows: np.ndarray) -> np.ndarray:
        """Where padded rows are in the vectors of its depth."""
        return self.group.vector + self.place * self.group.rows + rows

    def panel(self, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
        """Where padded rows and columns are in the panels of its depth."""
        first = self.place * self.group.rows
        return self.group.panel + (first + rows) * self.group.pivots + columns

    def update(self, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
        """Where padded rows and columns are in the updates of its depth."""
        p, u = self.group.pivots, self.group.others
        return self.group.update + (self.place * u + rows - p) * u + columns - p


def plan_fronts(
    pattern: SparsePattern, tree: EliminationTree, *, group_cost: float, device: torch.device
) -> Fronts:
    """Fronts of all matrices of a pattern.

    Args:
        group_cost: floating point operations of padding that one group less is worth: the
            overhead of a handful of calls.
        device: of the index lists.
    """
    n, indptr = pattern.size, pattern.indptr
    # Positions in the order of elimination: the deepest nodes first.
    order = np.concatenate(tree.pivots[::-1])
    position = np.empty(n, dtype=np.int64)
    position[order] = np.arange(n)
    rows = np.repeat(np.arange(n), np.diff(indptr))
    pairs = np.sort(np.stack([position[rows], position[pattern.indices]]), axis=0)
    by_row = np.argsort(pairs[0], kind="stable")
    bounds = np.searchsorted(pairs[0, by_row], np.arange(n + 1))

    children: list[list[_Front]] = [[] for _ in tree.pivots]
    depths: list[list[_Front]] = [[] for _ in range(tree.depth[-1] + 1)]
    end = 0
    for node in reversed(range(len(tree.pivots))):
        start, end = end, end + len(tree.pivots[node])
        entries = by_row[bounds[start] : bounds[end]]
        reached = [pairs[1, entries], *(child.rows[child.own :] for child in children[node])]
        later = np.unique(np.concatenate(reached))
        rows = np.concatenate([np.arange(start, end), later[later >= end]])
        front = _Front(rows, end - start, entries, children[node])
        depths[tree.depth[node]].append(front)
        if tree.parent[node] >= 0:
            children[tree.parent[node]].append(front)
    sizes = [np.array([(front.own, len(front.rows) - front.own) for front in fronts])
             for fronts in depths]
    groups = [_grouped(fronts, own, group_cost)
              for fronts, own in zip(depths, sizes, strict=True)]
    levels = [_level(*parts, pairs, order, device) for parts in zip(depths, groups, strict=True)]
    return Fronts(levels, np.concatenate(sizes))


def _grouped(fronts: list[_Front], sizes: np.ndarray, group_cost: float) -> list[Group]:
    """Give the fronts of one depth, of sizes (N, 2) without padding, their groups and places."""
    groups: list[Group] = []
    panel = update = vector = 0
    for members in _similar(sizes, group_cost):
        c, (p, u) = len(members), (int(size) for size in sizes[members].max(axis=0))
        groups.append(Group(c, p, u, panel, update, vector))
        panel, update, vector = panel + c * (p + u) * p, update + c * u * u, vector + c * (p + u)
        for place, member in enumerate(members):
            fronts[member].group, fronts[member].place = groups[-1], place
    return groups


def _similar(sizes: np.ndarray, group_cost: float) -> list[np.ndarray]:
    """Split fronts of sizes (N, 2) into groups, as long as that saves more than it costs."""
    def cost(count: np.ndarray | int, largest: np.ndarray) -> np.ndarray:
        return count * front_flops(*largest.T.astype(np.float64))

    least, parts = cost(len(sizes), sizes.max(axis=0)) - group_cost, None
    for axis in (0, 1):
        order = np.argsort(sizes[:, axis], kind="stable")
        small = np.maximum.accumulate(sizes[order])[:-1]
        large = np.maximum.accumulate(sizes[order[::-1]])[-2::-1]
        count = np.arange(1, len(sizes))
        total = cost(count, small) + cost(len(sizes) - count, large)
        if len(total) and total.min() < least:
            at = total.argmin() + 1
            least, parts = total[at - 1], (order[:at], order[at:])
    if parts is None:
        return [np.arange(len(sizes))]
    return [part[group] for part in parts for group in _similar(sizes[part], group_cost)]


def _level(
    fronts: list[_Front],
    groups: list[Group],
    pairs: np.ndarray,
    order: np.ndarray,
    device: torch.device,
) -> Level:
    """One depth, whose fronts have their places, as have those of the next.

    Args:
        pairs: (2, nnz) positions of the matrix's entries, the smaller first.
        order: (n,) row of each position.
    """
    def joined(parts: list[np.ndarray]) -> torch.Tensor:
        return torch.from_numpy(np.concatenate(parts)).to(device)

    def flow(parts: list[tuple[np.ndarray, np.ndarray]]) -> Flow:
        take, put = zip(*parts, strict=True)
        return joined(take), joined(put)

    unknowns = np.full(sum(group.count * group.rows for group in groups), len(order))
    ones, values = [], []
    for front in fronts:
        unknowns[front.vector(front.local(front.rows))] = order[front.rows]
        padded = np.arange(front.own, front.group.pivots)
        ones.append(front.panel(padded, padded))
        low, high = front.local(pairs[:, front.entries])
        values.append((front.entries, front.panel(high, low)))
    children = []
    for rank in range(max(len(front.children) for front in fronts)):
        panels, updates, vectors = [], [], []
        for front in fronts:
            for child in front.children[rank : rank + 1]:
                later = child.rows[child.own :]
                here, there = front.local(later), child.local(later)
                i, j = np.tril_indices(len(later))
                take = child.update(there[i], there[j])
                pivot = here[j] < front.group.pivots
                panels.append((take[pivot], front.panel(here[i[pivot]], here[j[pivot]])))
                updates.append((take[~pivot], front.update(here[i[~pivot]], here[j[~pivot]])))
                vectors.append((child.vector(there), front.vector(here)))
        children.append((flow(panels), flow(updates), flow(vectors)))
    return Level(groups, joined([unknowns]), joined(ones), flow(values), children)
