"""Where the dense fronts of a sparse Cholesky factorisation lie, and what flows between them.

Fronts of one height and of similar sizes are padded to one size and form a group. For one sample,
a group of c fronts with p pivots and u other unknowns has three pieces, all row-major: the corner
(c, p, p), upper triangle; the rows (c, u, p), which couple the others with the pivots; the rest
(c, u, u), lower triangle. Padded pivots have a one on the diagonal, everything else padded is
zero. For solves, the fronts of one height share a workspace of vectors, with two pieces per group:
(c, p) and (c, u).
"""

from dataclasses import dataclass

import numpy as np

from sim.linear.nested_dissection import EliminationTree

CORNER, ROWS, REST = range(3)
VALUES = -1


@dataclass(frozen=True)
class Flow:
    """Numbers added to a piece of a group; no target occurs twice in one flow.

    Attributes:
        source: the group whose rest they come from, counted through all heights; ``VALUES`` for
            the matrix's CSR data.
        piece: CORNER, ROWS or REST.
        take, put: (M,) entries of the source and of the piece.
    """

    source: int
    piece: int
    take: np.ndarray
    put: np.ndarray


@dataclass(frozen=True)
class Group:
    """Fronts of one height and one padded size.

    Attributes:
        nodes: (c,) of the tree.
        pivots, others: p and u, padded.
        vector: where the group's pieces begin in the vectors of its height.
        ones: (M,) entries of the corner that are padded pivots' diagonal.
        flows: what the fronts are made of.
    """

    nodes: np.ndarray
    pivots: int
    others: int
    vector: int
    ones: np.ndarray
    flows: tuple[Flow, ...]

    @property
    def flops(self) -> float:
        """Floating point operations of its factorisation."""
        return len(self.nodes) * front_flops(float(self.pivots), float(self.others))


@dataclass(frozen=True)
class VectorFlow:
    """What a solve hands on from one group to the fronts of one height.

    Attributes:
        source: the group, counted through all heights.
        take, put: (M,) entries of the group's (c, u) vectors and of the height's vectors; no
            target occurs twice.
    """

    source: int
    take: np.ndarray
    put: np.ndarray


@dataclass(frozen=True)
class Level:
    """Fronts of one height.

    Attributes:
        first: number of the first group, counted through all heights.
        groups: the height's groups.
        vector_size: entries of its vectors.
        flows: what the vectors receive from lower heights.
        unknowns: (vector_size,) the matrix's row of each entry, n for padding.
    """

    first: int
    groups: tuple[Group, ...]
    vector_size: int
    flows: tuple[VectorFlow, ...]
    unknowns: np.ndarray


def front_flops(p: float, u: float) -> float:
    """Of a front as carried out: Cholesky, triangular solve, the update's both triangles."""
    return p**3 / 3 + p**2 * u + 2 * p * u**2


class FrontLayout:
    """Where each front lies in its group, and the index lists that follow."""

    def __init__(
        self,
        tree: EliminationTree,
        starts: np.ndarray,
        counts: np.ndarray,
        others: list[np.ndarray],
        sizes: np.ndarray,
        group_cost: float,
    ) -> None:
        self.tree, self.starts, self.counts, self.others = tree, starts, counts, others
        self.height = tree.height
        self.members = [
            _similar(np.flatnonzero(self.height == height), sizes, group_cost)
            for height in range(self.height.max() + 1)
        ]
        # Of each node: padded sizes, group, place in the group, beginnings of its vectors.
        self.p, self.u, self.group, self.member, self.own_vector, self.later_vector = np.zeros(
            (6, len(counts)), dtype=np.int64
        )
        number = 0
        for level in self.members:
            vector = 0
            for nodes in level:
                p, u = sizes[nodes].max(axis=0)
                self.p[nodes], self.u[nodes] = p, u
                self.group[nodes], self.member[nodes] = number, np.arange(len(nodes))
                self.own_vector[nodes] = vector + self.member[nodes] * p
                self.later_vector[nodes] = vector + len(nodes) * p + self.member[nodes] * u
                vector += len(nodes) * (p + u)
                number += 1

    def levels(self, entries: np.ndarray, unknown: np.ndarray) -> tuple[Level, ...]:
        """``entries`` (2, nnz) positions of the matrix's; ``unknown`` (n + 1,) by position."""
        flows, vector_flows = self._flows(entries)
        levels, first = [], 0
        for height, level in enumerate(self.members):
            groups = []
            for nodes in level:
                p, u = int(self.p[nodes[0]]), int(self.u[nodes[0]])
                ones = [
                    self.member[node] * p * p + np.arange(self.counts[node], p) * (p + 1)
                    for node in nodes
                ]
                groups.append(
                    Group(nodes, p, u, int(self.own_vector[nodes[0]]), np.concatenate(ones),
                          tuple(flows[first + len(groups)]))
                )
            size = sum(len(g.nodes) * (g.pivots + g.others) for g in groups)
            positions = self._positions(np.concatenate(level), size, len(unknown) - 1)
            levels.append(
                Level(first, tuple(groups), size, tuple(vector_flows[height]), unknown[positions])
            )
            first += len(groups)
        return tuple(levels)

    def _local(self, node: int, positions: np.ndarray) -> np.ndarray:
        """Rows of a node's padded front."""
        own = positions - self.starts[node]
        later = self.p[node] + np.searchsorted(self.others[node], positions)
        return np.where(own < self.counts[node], own, later)

    def _pieces(
        self, node: int, low: np.ndarray, high: np.ndarray
    ) -> list[tuple[int, np.ndarray, np.ndarray]]:
        """Which rows' pairs low <= high of a front lie in which piece, and where there."""
        p, u, member = self.p[node], self.u[node], self.member[node]
        masks = high < p, (low < p) & (high >= p), low >= p
        places = (
            (member * p + low) * p + high,
            (member * u + high - p) * p + low,
            (member * u + high - p) * u + low - p,
        )
        return [
            (piece, np.flatnonzero(mask), place[mask])
            for piece, (mask, place) in enumerate(zip(masks, places, strict=True))
            if mask.any()
        ]

    def _positions(self, nodes: np.ndarray, size: int, padding: int) -> np.ndarray:
        """(size,) position that each entry of a height's vectors stands for."""
        positions = np.full(size, padding)
        for node in nodes:
            at, count = self.own_vector[node], self.counts[node]
            positions[at : at + count] = self.starts[node] + np.arange(count)
            at, others = self.later_vector[node], self.others[node]
            positions[at : at + len(others)] = others
        return positions

    def _flows(self, entries: np.ndarray) -> tuple[list[list[Flow]], list[list[VectorFlow]]]:
        """For each group what its fronts are made of, for each height what vectors receive.

        Siblings of one group go into different flows, so that no target occurs twice and sums
        do not depend on the order in which a device adds.
        """
        parts = _Parts()
        vector_parts = _Parts()
        owner = np.repeat(np.arange(len(self.counts)), self.counts)[entries[0]]
        order = np.argsort(owner, kind="stable")
        bounds = np.searchsorted(owner[order], np.arange(len(self.counts) + 1))
        earlier: dict[tuple[int, int], int] = {}
        for node, parent in enumerate(self.tree.parent):
            own = order[bounds[node] : bounds[node + 1]]
            low, high = (self._local(node, entries[k, own]) for k in (0, 1))
            for piece, chosen, put in self._pieces(node, low, high):
                parts.add((self.group[node], VALUES, 0, piece), own[chosen], put)
            if parent < 0 or not len(self.others[node]):
                continue
            sibling = (int(self.group[node]), int(parent))
            slot = earlier[sibling] = earlier.get(sibling, -1) + 1
            to = self._local(parent, self.others[node])
            first = self.member[node] * self.u[node]
            row, column = np.tril_indices(len(to))
            take = (first + row) * self.u[node] + column
            for piece, chosen, put in self._pieces(parent, to[column], to[row]):
                parts.add((self.group[parent], sibling[0], slot, piece), take[chosen], put)
            later = self.later_vector[parent] + to - self.p[parent]
            put = np.where(to < self.p[parent], self.own_vector[parent] + to, later)
            key = (self.height[parent], sibling[0], slot)
            vector_parts.add(key, first + np.arange(len(to)), put)
        flows: list[list[Flow]] = [[] for _ in range(self.group.max() + 1)]
        for (group, source, _, piece), indices in parts.joined():
            flows[group].append(Flow(source, piece, *indices))
        vector_flows: list[list[VectorFlow]] = [[] for _ in self.members]
        for (height, source, _), indices in vector_parts.joined():
            vector_flows[height].append(VectorFlow(source, *indices))
        return flows, vector_flows


class _Parts:
    """Pairs of index lists collected under keys."""

    def __init__(self) -> None:
        self._lists: dict[tuple[int, ...], list[tuple[np.ndarray, np.ndarray]]] = {}

    def add(self, key: tuple[int, ...], take: np.ndarray, put: np.ndarray) -> None:
        self._lists.setdefault(tuple(int(k) for k in key), []).append((take, put))

    def joined(self) -> list[tuple[tuple[int, ...], list[np.ndarray]]]:
        """The lists of each key end to end, by key."""
        return [
            (key, [np.concatenate(column) for column in zip(*pairs, strict=True)])
            for key, pairs in sorted(self._lists.items(), key=lambda item: item[0])
        ]


def _similar(nodes: np.ndarray, sizes: np.ndarray, group_cost: float) -> list[np.ndarray]:
    """Split nodes of one height into groups: merged while padding costs less than a group."""
    distinct, inverse = np.unique(sizes[nodes], axis=0, return_inverse=True)
    groups = [(nodes[inverse.ravel() == k], size) for k, size in enumerate(distinct)]

    def cost(count: int, size: np.ndarray) -> float:
        return count * front_flops(float(size[0]), float(size[1]))

    while len(groups) > 1:
        best, least = None, group_cost
        for a in range(len(groups)):
            for b in range(a):
                (one, p), (two, q) = groups[a], groups[b]
                joint = np.maximum(p, q)
                added = cost(len(one) + len(two), joint) - cost(len(one), p) - cost(len(two), q)
                if added < least:
                    best, least = (a, b, joint), added
        if best is None:
            break
        a, b, joint = best
        merged = np.concatenate([groups[a][0], groups[b][0]])
        groups = [g for k, g in enumerate(groups) if k not in (a, b)] + [(merged, joint)]
    return [np.sort(group) for group, _ in groups]
