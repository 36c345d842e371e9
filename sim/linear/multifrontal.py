"""Cholesky factorisation of many sparse matrices of one pattern at once, in plain PyTorch.

    P A Pᵀ = L Lᵀ,  A x = b  by  L y = P b,  Lᵀ (P x) = y

P is the order of elimination of :mod:`sim.linear.nested_dissection`; L is kept as the dense pieces
that :mod:`sim.linear.front_layout` describes. Every operation takes the fronts of one group in
all samples together, so that the number of calls depends neither on the batch nor, much, on the
mesh, and nothing waits for the device on the way. A sample's numbers never meet another's: a
matrix that is not positive definite spoils its own sample alone.
"""

import math
from dataclasses import dataclass

import numpy as np
import torch

from common.errors import InputError
from sim.linear.front_layout import CORNER, REST, ROWS, VALUES, Group
from sim.linear.fronts import Fronts, plan_fronts
from sim.linear.nested_dissection import EliminationTree, dissect
from sim.linear.pattern import SparsePattern

LEAF = 60
"""Default of ``leaf`` (:func:`analyse`), unknowns."""
GROUP_COST = 2e6
"""Default of ``group_cost`` (:func:`analyse`), floating point operations."""
ENTRY_COST = 50.0
"""Default of ``entry_cost`` (:func:`analyse`), floating point operations."""


@dataclass(frozen=True)
class Analysis:
    """What the factorisations of one pattern share; made by :func:`analyse`.

    Attributes:
        fronts: layout and counts.
        values: entries in the CSR data of one matrix.
        device: of the index lists, and so of the matrices.
    """

    fronts: Fronts
    values: int
    device: torch.device
    _indices: dict[int, torch.Tensor]  # by the identity of the array in ``fronts``

    @property
    def groups(self) -> list[Group]:
        """Stacks of fronts: each takes one dense Cholesky, triangular solve and product."""
        return [group for level in self.fronts.levels for group in level.groups]

    @property
    def padded_flops(self) -> float:
        """Floating point operations of one factorisation as carried out."""
        return sum(group.flops for group in self.groups)

    @property
    def calls(self) -> int:
        """Calls of PyTorch's tensor functions (kernels, on a GPU) in one factorisation."""
        # A group's: three pieces zeroed, ones, Cholesky, check (3), triangular solve, product.
        return sum(10 + 2 * len(group.flows) for group in self.groups)

    @property
    def index_bytes(self) -> int:
        """Memory of the index lists, shared by all samples."""
        return sum(index.nbytes for index in self._indices.values())

    def index(self, array: np.ndarray) -> torch.Tensor:
        """An index list of :attr:`fronts` on the device."""
        return self._indices[id(array)]


def analyse(
    pattern: SparsePattern,
    places: np.ndarray | EliminationTree,
    *,
    leaf: int = LEAF,
    group_cost: float = GROUP_COST,
    entry_cost: float = ENTRY_COST,
    device: torch.device | str = "cpu",
) -> Analysis:
    """Order of elimination and index lists for all matrices of a pattern.

    Args:
        pattern: of the upper triangle.
        places: (n, d) where each unknown lies, for :func:`sim.linear.nested_dissection.dissect`:
            of a grid its integer places, of any other mesh the rest places of vertices and
            middles of edges. Or an elimination tree.
        leaf: regions of at most so many unknowns become one front.
        group_cost: floating point operations that a stack of fronts less is worth; more means
            fewer and larger calls.
        entry_cost: floating point operations that handing on an entry of a front's update is
            worth; more means fewer and larger fronts.

    Raises:
        InputError: places or a tree that do not fit the pattern.
    """
    tree = places
    if not isinstance(tree, EliminationTree):
        tree = dissect(pattern.indptr, pattern.indices, places, leaf=leaf)
    fronts = plan_fronts(
        tree, pattern.indptr, pattern.indices, group_cost=group_cost, entry_cost=entry_cost
    )
    arrays = [level.unknowns for level in fronts.levels]
    for level in fronts.levels:
        arrays += [array for flow in level.flows for array in (flow.take, flow.put)]
        for group in level.groups:
            arrays.append(group.ones)
            arrays += [array for flow in group.flows for array in (flow.take, flow.put)]
    indices = {id(array): torch.from_numpy(array).to(device) for array in arrays}
    # As tensors say it: a device "cuda" is not equal to theirs, "cuda:0".
    device = torch.empty(0, device=device).device
    return Analysis(fronts, len(pattern.indices), device, indices)


class BatchedCholesky:
    """Factorises batches of matrices of one pattern; all memory is kept for the next batch.

    The batch may have another size each time, as when finished samples leave it.
    """

    def __init__(self, analysis: Analysis) -> None:
        self.analysis = analysis
        self.positive_definite = torch.empty(0, dtype=torch.bool, device=analysis.device)
        self._memory: dict[object, torch.Tensor] = {}
        self._slots = _shared_slots(analysis.groups)
        self._corners: list[torch.Tensor] = []  # of each group (B, c, p, p), lower triangular
        self._rows: list[torch.Tensor] = []  # (B, c, p, u): the transpose of L below the corner

    @property
    def nbytes(self) -> int:
        """Memory kept, without the analysis' index lists."""
        return sum(buffer.nbytes for buffer in self._memory.values())

    def factorise(self, values: torch.Tensor) -> torch.Tensor:
        """Factor the matrices with the CSR data ``values`` (B, nnz) of the upper triangle.

        Data in the shared pattern, not element blocks, are what is passed: one scatter of all
        blocks makes them (:meth:`sim.linear.SparsePattern.slots` says where to, for each
        sample's own triangulation), and shifts and blends of Hessians are sums of them.

        Args:
            values: float64 on the analysis' device.

        Returns:
            (B,) bool, on the device: whether each matrix is positive definite. The others have
            no factor, and their solutions mean nothing.

        Raises:
            InputError: another shape, type or device.
        """
        if values.ndim != 2 or values.shape[1] != self.analysis.values:
            raise InputError(f"values {tuple(values.shape)} do not fit the pattern; "
                             f"give (B, {self.analysis.values})")
        _check(values, self.analysis)
        definite = values.isfinite().all(dim=1)
        self._corners, self._rows = [], []
        rests: dict[int, torch.Tensor] = {}
        for number, group in enumerate(self.analysis.groups):
            corner, rows, rest = self._assemble(number, group, values, rests)
            lower = corner.mT
            info = torch.empty(corner.shape[:2], dtype=torch.int32, device=values.device)
            torch.linalg.cholesky_ex(lower, out=(lower, info))
            definite &= (info == 0).all(dim=1)
            self._corners.append(lower)
            self._rows.append(rows.mT)
            if group.others:
                torch.linalg.solve_triangular(lower, rows.mT, upper=False, out=rows.mT)
                flat = rows.flatten(0, 1)
                rest.flatten(0, 1).baddbmm_(flat, flat.mT, alpha=-1.0)
                rests[number] = rest
        self.positive_definite = definite
        return definite

    def solve(self, rhs: torch.Tensor) -> torch.Tensor:
        """Solutions of A x = ``rhs``, (B, n) or (B, n, k), with the last factors.

        Raises:
            InputError: another shape, type or device than that of the last factors.
        """
        samples, n = len(self.positive_definite), self.analysis.fronts.size
        if rhs.ndim not in (2, 3) or rhs.shape[:2] != (samples, n):
            raise InputError(f"right-hand sides {tuple(rhs.shape)} do not fit {samples} matrices "
                             f"of {n} rows; give ({samples}, {n}) or ({samples}, {n}, k)")
        _check(rhs, self.analysis)
        columns = rhs if rhs.ndim == 3 else rhs[..., None]
        # The row n stands for padding: zero on the way in, and it stays so.
        x = torch.cat([columns, columns.new_zeros(samples, 1, columns.shape[2])], dim=1)
        self._backward(x, self._forward(x))
        return x[:, :n].reshape(rhs.shape)

    def _assemble(
        self, number: int, group: Group, values: torch.Tensor, rests: dict[int, torch.Tensor]
    ) -> tuple[torch.Tensor, ...]:
        """Corner (B, c, p, p), rows (B, c, u, p) and rest (B, c, u, u) of a group, filled."""
        samples, c, p, u = len(values), len(group.nodes), group.pivots, group.others
        pieces = {
            CORNER: self._buffer((CORNER, number), (samples, c, p, p)).zero_(),
            ROWS: self._buffer((ROWS, number), (samples, c, u, p)).zero_(),
            REST: self._buffer((REST, self._slots[number]), (samples, c, u, u)).zero_(),
        }
        pieces[CORNER].view(samples, -1).index_fill_(1, self.analysis.index(group.ones), 1.0)
        for flow in group.flows:
            source = values if flow.source == VALUES else rests[flow.source].flatten(1)
            take, put = self.analysis.index(flow.take), self.analysis.index(flow.put)
            part = self._buffer("part", (samples, len(take)))
            torch.gather(source, 1, take.expand(samples, -1), out=part)
            # No target occurs twice, so that a GPU's sums have one order too.
            pieces[flow.piece].view(samples, -1).scatter_add_(1, put.expand(samples, -1), part)
        return tuple(pieces.values())

    def _buffer(self, name: object, shape: tuple[int, ...]) -> torch.Tensor:
        """A tensor in memory that is kept: fresh memory costs more than the arithmetic."""
        count = math.prod(shape)
        kept = self._memory.get(name)
        if kept is None or len(kept) < count:
            device = self.analysis.device
            kept = self._memory[name] = torch.empty(count, dtype=torch.float64, device=device)
        return kept[:count].view(shape)

    def _forward(self, x: torch.Tensor) -> list[torch.Tensor]:
        """For each group y (B, c, p, k) of L y = P x."""
        samples, _, k = x.shape
        carried: list[torch.Tensor] = []
        reduced: list[torch.Tensor] = []
        for level in self.analysis.fronts.levels:
            work = x.new_zeros(samples, level.vector_size, k)
            unknowns = self.analysis.index(level.unknowns)
            for group in level.groups:
                own = _own(group)
                work[:, own] = _take(x, unknowns[own])
            for flow in level.flows:
                part = _take(carried[flow.source].flatten(1, 2), self.analysis.index(flow.take))
                work.scatter_add_(1, _wide(self.analysis.index(flow.put), work), part)
            for number, group in enumerate(level.groups, level.first):
                own, later = _vectors(work, group)
                y = torch.linalg.solve_triangular(self._corners[number], own, upper=False)
                reduced.append(y)
                carried.append(later - self._rows[number].mT @ y)
        return reduced

    def _backward(self, x: torch.Tensor, reduced: list[torch.Tensor]) -> None:
        """Fill x (B, n + 1, k) with Pᵀ L⁻ᵀ y."""
        for level in reversed(self.analysis.fronts.levels):
            unknowns = self.analysis.index(level.unknowns)
            work = _take(x, unknowns)
            for number, group in enumerate(level.groups, level.first):
                later = _vectors(work, group)[1].mT
                y = reduced[number] - (later @ self._rows[number].mT).mT
                own = torch.linalg.solve_triangular(self._corners[number].mT, y, upper=True)
                x.scatter_(1, _wide(unknowns[_own(group)], x), own.flatten(1, 2))


def _shared_slots(groups: list[Group]) -> list[int]:
    """A number for each group's rests, so that no two in use at a time have the same one."""
    last_use = {flow.source: k for k, group in enumerate(groups) for flow in group.flows}
    sizes: list[int] = []
    free: list[int] = []
    slots: list[int] = []
    for number, group in enumerate(groups):
        needed = len(group.nodes) * group.others**2
        # The smallest that is large enough, or else the largest, to be enlarged.
        free.sort(key=lambda slot: sizes[slot])
        fitting = [slot for slot in free if sizes[slot] >= needed]
        slot = fitting[0] if fitting else free[-1] if free else len(sizes)
        if slot == len(sizes):
            sizes.append(0)
        else:
            free.remove(slot)
        sizes[slot] = max(sizes[slot], needed)
        slots.append(slot)
        free += [slots[k] for k in range(number + 1) if last_use.get(k, k) == number]
    return slots


def _own(group: Group) -> slice:
    """The pivots in the vectors of the group's height."""
    return slice(group.vector, group.vector + len(group.nodes) * group.pivots)


def _vectors(work: torch.Tensor, group: Group) -> tuple[torch.Tensor, torch.Tensor]:
    """The group's (B, c, p, k) and (B, c, u, k) in the workspace (B, size, k)."""
    c, p, u = len(group.nodes), group.pivots, group.others
    own, later = work[:, group.vector : group.vector + c * (p + u)].split((c * p, c * u), dim=1)
    return own.unflatten(1, (c, p)), later.unflatten(1, (c, u))


def _take(source: torch.Tensor, index: torch.Tensor) -> torch.Tensor:
    """Entries ``index`` (M,) along dimension 1."""
    return source.gather(1, _wide(index, source))


def _wide(index: torch.Tensor, like: torch.Tensor) -> torch.Tensor:
    if like.ndim == 2:
        return index.expand(len(like), -1)
    return index[None, :, None].expand(len(like), -1, like.shape[2])


def _check(tensor: torch.Tensor, analysis: Analysis) -> None:
    if tensor.dtype != torch.float64 or tensor.device != analysis.device:
        raise InputError(f"float64 on {analysis.device} is needed, got {tensor.dtype} on "
                         f"{tensor.device}")
