"""Symbolic part of a multifrontal Cholesky factorisation: dense fronts, and what flows between.

Eliminating a node of the elimination tree works on a dense matrix, its front: the node's pivots
and the later unknowns they couple with, its others. What is left of the front after the
elimination, the update, is added to the parent's front (Duff and Reid 1983; Liu 1992). Fronts of
one depth in the tree do not depend on each other; those of similar sizes are padded to one size
and form a group, to be handled as one stack of matrices.

The fronts of one depth lie in one array: group after group (c, m, m) row-major, of which the
lower triangles are used, with the p pivots before the u = m - p others. Padded pivots have a one
on the diagonal, everything else padded is zero. For solves, vectors (c, m) lie likewise.
"""

from dataclasses import dataclass

import numpy as np
import torch

from sim.linear.nested_dissection import EliminationTree

Flow = tuple[torch.Tensor, torch.Tensor]
"""Entries to take from one array and where to add them in another; no target occurs twice, so
that sums have one order on every device."""


@dataclass(frozen=True)
class Group:
    """Fronts of one depth and one padded size.

    Attributes:
        count, pivots, others: c, p and u.
        matrix, vector: where the group begins in the depth's matrices and vectors.
    """

    count: int
    pivots: int
    others: int
    matrix: int
    vector: int

    @property
    def size(self) -> int:
        """Rows of each front, m."""
        return self.pivots + self.others

    def fronts(self, matrices: torch.Tensor) -> torch.Tensor:
        """The group's (B, c, m, m) in the matrices of its depth in B samples."""
        length = self.count * self.size**2
        return matrices[:, self.matrix : self.matrix + length].view(
            -1, self.count, self.size, self.size)

    def columns(self, vectors: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """The group's pivots (B, c, p, 1) and others (B, c, u, 1) in the vectors of its depth."""
        part = vectors[:, self.vector : self.vector + self.count * self.size]
        both = part.view(-1, self.count, self.size, 1).split((self.pivots, self.others), dim=2)
        return both[0], both[1]


@dataclass(frozen=True)
class Level:
    """The fronts of one depth.

    Attributes:
        groups: by size.
        unknowns: (R,) the row of the whole matrix for each entry of the depth's vectors, n for
            padding.
        ones: (M,) entries of the matrices that are padded pivots' diagonal.
        values: from the CSR data to the matrices.
        updates: from the matrices of the next depth, of first children, of second children.
        carried: from the vectors of the next depth, likewise.
    """

    groups: list[Group]
    unknowns: torch.Tensor
    ones: torch.Tensor
    values: Flow
    updates: list[Flow]
    carried: list[Flow]

    @property
    def entries(self) -> int:
        """Numbers in the depth's matrices."""
        return sum(group.count * group.size**2 for group in self.groups)


@dataclass(frozen=True)
class Fronts:
    """All fronts of a matrix.

    Attributes:
        levels: by depth, the root first.
        sizes: (N, 2) pivots and others of each front without padding.
    """

    levels: list[Level]
    sizes: np.ndarray

    @property
    def flops(self) -> float:
        """Floating point operations of a factorisation without padding, of one triangle each."""
        p, u = self.sizes.T.astype(np.float64)
        return float((p**3 / 3 + p**2 * u + p * u**2).sum())

    @property
    def factor_entries(self) -> int:
        """Of the Cholesky factor without padding."""
        p, u = self.sizes.T
        return int((p * (p + 1) // 2 + p * u).sum())

    @property
    def padded_flops(self) -> float:
        """Floating point operations of a factorisation as carried out."""
        return sum(group.count * front_flops(group.pivots, group.others)
                   for level in self.levels for group in level.groups)


def front_flops(p: float, u: float) -> float:
    """Of a front as carried out: Cholesky, triangular solve, the update's both triangles."""
    return p**3 / 3 + p**2 * u + 2 * p * u**2


def plan_fronts(
    tree: EliminationTree,
    indptr: np.ndarray,
    indices: np.ndarray,
    *,
    group_cost: float,
    device: torch.device,
) -> Fronts:
    """Fronts of all matrices with the upper triangle ``indptr``, ``indices`` (CSR).

    Args:
        group_cost: floating point operations of padding that one group less is worth: the
            overhead of a handful of calls.
        device: of the index lists.
    """
    n = len(indptr) - 1
    # Positions in the order of elimination: the deepest nodes first.
    order = np.concatenate(tree.pivots[::-1])
    position = np.empty(n, dtype=np.int64)
    position[order] = np.arange(n)
    pairs = np.stack([position[np.repeat(np.arange(n), np.diff(indptr))], position[indices]])
    pairs.sort(axis=0)
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

    groups = [_place(fronts, group_cost) for fronts in depths]
    levels = [_level(*both, pairs, order, device) for both in zip(groups, depths, strict=True)]
    sizes = [(front.own, len(front.rows) - front.own) for fronts in depths for front in fronts]
    return Fronts(levels, np.array(sizes))


@dataclass
class _Front:
    """One front and where it lies.

    Attributes:
        rows: positions of its rows without padding, ascending.
        own: how many of them are pivots.
        entries: of the matrix, that belong to it and to none of its descendants.
        children: the fronts whose updates it receives.
        pivots, size: padded.
        matrix, vector: where it begins in the matrices and vectors of its depth.
    """

    rows: np.ndarray
    own: int
    entries: np.ndarray
    children: list["_Front"]
    pivots: int = 0
    size: int = 0
    matrix: int = 0
    vector: int = 0

    def local(self, positions: np.ndarray) -> np.ndarray:
        """Padded rows of positions that the front has."""
        row = np.searchsorted(self.rows, positions)
        return np.where(row < self.own, row, row + self.pivots - self.own)

    def address(self, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
        """Where padded rows and columns are in the matrices of its depth."""
        return self.matrix + rows * self.size + columns


def _place(fronts: list[_Front], group_cost: float) -> list[Group]:
    """Give all fronts of one depth their places, in groups."""
    sizes = np.array([(front.own, len(front.rows) - front.own) for front in fronts])
    groups, matrix, vector = [], 0, 0
    for members in _similar(sizes, group_cost):
        pivots, others = (int(size) for size in sizes[members].max(axis=0))
        groups.append(Group(len(members), pivots, others, matrix, vector))
        for member in members:
            front = fronts[member]
            front.pivots, front.size = pivots, pivots + others
            front.matrix, front.vector = matrix, vector
            matrix += front.size**2
            vector += front.size
    return groups


def _similar(sizes: np.ndarray, group_cost: float) -> list[np.ndarray]:
    """Split fronts of sizes (N, 2) into groups, as long as that saves more than it costs."""
    def cost(count: np.ndarray | int, size: np.ndarray) -> np.ndarray:
        return count * front_flops(*size.T.astype(np.float64))

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
    groups: list[Group],
    fronts: list[_Front],
    pairs: np.ndarray,
    order: np.ndarray,
    device: torch.device,
) -> Level:
    """The index lists of one depth; all fronts have their places.

    Args:
        pairs: (2, nnz) positions of the matrix's entries, the smaller first.
        order: (n,) row of each position.
    """
    unknowns = np.full(sum(group.count * group.size for group in groups), len(order))
    ones, values = [], []
    for front in fronts:
        unknowns[front.vector + front.local(front.rows)] = order[front.rows]
        padded = np.arange(front.own, front.pivots)
        ones.append(front.address(padded, padded))
        low, high = front.local(pairs[:, front.entries])
        values.append((front.entries, front.address(high, low)))
    updates, carried = [], []
    for rank in range(max(len(front.children) for front in fronts)):
        matrices, vectors = [], []
        for front in fronts:
            for child in front.children[rank : rank + 1]:
                later = child.rows[child.own :]
                here, there = front.local(later), child.local(later)
                i, j = np.tril_indices(len(later))
                matrices.append((child.address(there[i], there[j]), front.address(here[i], here[j])))
                vectors.append((child.vector + there, front.vector + here))
        updates.append(_joined(matrices, device))
        carried.append(_joined(vectors, device))
    return Level(
        groups=groups,
        unknowns=torch.from_numpy(unknowns).to(device),
        ones=torch.from_numpy(np.concatenate(ones)).to(device),
        values=_joined(values, device),
        updates=updates,
        carried=carried,
    )


def _joined(parts: list[tuple[np.ndarray, np.ndarray]], device: torch.device) -> Flow:
    take, put = (torch.from_numpy(np.concatenate(column)).to(device)
                 for column in zip(*parts, strict=True))
    return take, put
